"""The calibration file: written and read back the same, every malformed value at its line, taken only where it fits."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from protocols import BadInputError, document
from rig.calibrate import file_sections
from rig.config import calibration_files, calibration_schema, loader
from rig.config.board_sections import CheckerboardPattern
from rig.config.calibration_files import parse, read, text_of, write
from rig.config.optics import camera_in_base, lens_of, rigid
from rig.config.sections import LensConfig, Placement
from rig.hardware.cameras.opencv import serial_of
from runs.overwriting import WouldOverwriteError
from tests.support.budget import examples
from tests.support.command_line import invoke

SHA = "0" * 63 + "a"
finite = st.floats(-1e6, 1e6, allow_nan=False)
positive = st.floats(1e-3, 1e6, allow_nan=False)


def _matrix(size: int) -> calibration_schema.Matrix:
    spread = np.random.default_rng(size).normal(size=(size, size))
    return file_sections.matrix(spread @ spread.T)


def camera_file(**changed: Any) -> calibration_schema.CameraFile:
    """A camera's calibration for the mock rig."""
    values: dict[str, Any] = {
        **file_sections.origin(),
        "kind": "camera",
        "camera": calibration_schema.CameraIdentity(
            name="front", driver="mock", device="mock0", width_px=640, height_px=480
        ),
        "board": CheckerboardPattern(squares_x=10, squares_y=7, square_mm=16.0),
        "lens": LensConfig(fx_px=621.5, fy_px=620.5, cx_px=319.5, cy_px=241.0, distortion=(-0.12, 0.08, 0.0, 0.0, 0.0)),
        "covariance": _matrix(9),
        "rms_px": 0.05,
        "coverage_percent": 90.0,
        "views": (calibration_schema.UsedView(name="a.png", sha256=SHA, corners=54, rms_px=0.05),),
    }
    return calibration_schema.CameraFile(**{**values, **changed})


def tool_file(**changed: Any) -> calibration_schema.ToolFile:
    """A tool calibration for the mock rig."""
    values: dict[str, Any] = {
        **file_sections.origin(),
        "kind": "tool",
        "camera": calibration_schema.CameraIdentity(
            name="front", driver="mock", device="mock0", width_px=640, height_px=480
        ),
        "board": CheckerboardPattern(squares_x=7, squares_y=6, square_mm=8.0),
        "placement": Placement(translation_mm=(0.1, 0.2, 35.3), rotation_deg=(-60.2, 0.0, 0.1)),
        "covariance": _matrix(6),
        "views": (
            calibration_schema.ToolView(
                name="a.png", sha256=SHA, pose="straight", turned_deg=0.0, residual_mm=0.01, residual_deg=0.01
            ),
        ),
    }
    return calibration_schema.ToolFile(**{**values, **changed})


@st.composite
def camera_files(draw: st.DrawFn) -> calibration_schema.CameraFile:
    width, height = draw(st.integers(64, 9000)), draw(st.integers(64, 9000))
    lens = LensConfig(
        fx_px=draw(positive),
        fy_px=draw(positive),
        cx_px=width * draw(st.floats(0.01, 0.99)),
        cy_px=height * draw(st.floats(0.01, 0.99)),
        distortion=tuple(draw(st.lists(finite, min_size=5, max_size=5))),
    )
    text = st.text(st.characters(blacklist_categories=("Cs", "Cc")), min_size=1, max_size=20)
    return camera_file(
        camera=calibration_schema.CameraIdentity(
            name=draw(text), driver=draw(st.none() | text), device=draw(st.none() | text | st.integers(0, 9)),
            serial=draw(st.none() | text), width_px=width, height_px=height,
        ),
        note=draw(text),
        lens=lens,
        rms_px=draw(positive),
        views=tuple(
            calibration_schema.UsedView(
                name=draw(text), sha256=SHA, corners=draw(st.integers(1, 999)), rms_px=draw(positive)
            )
            for _ in range(draw(st.integers(1, 4)))
        ),
        advice=tuple(draw(st.lists(text, max_size=2))),
    )  # fmt: skip


@examples(20)
@given(found=camera_files())
def test_what_is_written_is_read_back_the_same(found: calibration_schema.CameraFile) -> None:
    again = parse(document.parse(text_of(found), "c.yaml"))
    assert again.found == found


def _leaves(data: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    if isinstance(data, dict):
        return [leaf for key, value in data.items() for leaf in _leaves(value, (*path, key))]
    if isinstance(data, list) and data:
        return [leaf for k, value in enumerate(data) for leaf in _leaves(value, (*path, k))]
    return [path]


WORDS = ("versions", "command", "note", "git_commit", "name", "device", "driver")
LEAVES = [
    leaf for leaf in _leaves(yaml.safe_load(text_of(camera_file()))) if not set(WORDS) & set(leaf) and len(leaf) > 1
]


@examples(25)
@given(leaf=st.sampled_from(LEAVES), junk=st.sampled_from([[], {"a": 1}, ".nan", "many", [1, 2], None]))
def test_every_malformed_value_is_named_with_its_file_and_line(leaf: tuple[str | int, ...], junk: Any) -> None:
    data = yaml.safe_load(text_of(camera_file()))
    at = data
    for step in leaf[:-1]:
        at = at[step]
    at[leaf[-1]] = junk
    text = yaml.safe_dump(data, sort_keys=False, width=120)
    with pytest.raises(BadInputError) as caught:
        parse(document.parse(text, "c.yaml"))
    for problem in caught.value.problems:
        assert problem.file == "c.yaml"
        assert problem.line > 0
        assert problem.expected


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("kind: camera", "kind: camra", "did you mean camera"),
        ("fx_px: 621.5", "fx_px: -1", "above 0"),
        ("width_px: 640", "width_px: 640.5", "whole number"),
        ("cx_px: 319.5", "cx_px: 700", "inside the picture"),
        ("softrig_calibration: 1", "softrig_calibration: 2", "1"),
        ("square_mm: 16.0", "square_mm: '16'", "without quotes"),
        (SHA, "too-short", "sha256"),
    ],
)
def test_a_mistake_gets_one_clear_message(old: str, new: str, expected: str) -> None:
    text = text_of(camera_file()).replace(old, new)
    line = text[: text.index(new)].count("\n") + 1
    with pytest.raises(BadInputError) as caught:
        parse(document.parse(text, "c.yaml"))
    assert f"c.yaml:{line}" in str(caught.value)
    assert expected in str(caught.value)


def test_a_date_needs_its_zone() -> None:
    text = re.sub(r"made: .*", "made: '2026-11-21'", text_of(camera_file()))
    with pytest.raises(BadInputError, match="date with time and zone"):
        parse(document.parse(text, "c.yaml"))


def test_a_file_states_its_time_program_and_source() -> None:
    found = camera_file()
    assert re.match(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", found.made)
    assert "opencv-python-headless" in found.software.versions


def test_a_file_is_overwritten_only_with_replace(tmp_path: Path) -> None:
    path = write(camera_file(), tmp_path / "c.yaml")
    with pytest.raises(WouldOverwriteError, match="--replace"):
        write(camera_file(note="second"), path)
    assert read(path).found.note == ""
    write(camera_file(note="second"), path, replace=True)
    assert read(path).found.note == "second"


def test_a_default_name_is_dated_and_lies_beside_no_other(tmp_path: Path) -> None:
    first = calibration_files.default_path("camera-front", tmp_path)
    assert re.fullmatch(r"camera-front-20\d\d-\d\d-\d\d\.yaml", first.name)
    first.touch()
    assert calibration_files.default_path("camera-front", tmp_path).stem == f"{first.stem}-2"
    (tmp_path / f"{first.stem}-2-views").mkdir()
    (tmp_path / f"{first.stem}-3.png").touch()
    assert calibration_files.default_path("camera-front", tmp_path).stem == f"{first.stem}-4"


def _rig(folder: Path, *names: str, **changes: str) -> Path:
    text = loader.text("mock").replace("name: mock\n", f"name: mock\ncalibrations: [{', '.join(names)}]\n")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    file = folder / "my.yaml"
    file.write_text(text)
    return file


def test_a_rig_uses_the_results_of_its_calibrations(tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    write(camera_file(), tmp_path / "made" / "c.yaml")
    write(tool_file(), tmp_path / "t.yaml")
    config = loader.load(_rig(tmp_path, "made/c.yaml", "t.yaml"))
    assert config.cameras["front"].lens.fx_px == 621.5
    assert config.board.placement.translation_mm == (0.1, 0.2, 35.3)


def test_the_simulator_stays_as_it_was_built(tmp_path: Path) -> None:
    write(camera_file(), tmp_path / "c.yaml")
    write(tool_file(), tmp_path / "t.yaml")
    before, after = loader.load("mock"), loader.load(_rig(tmp_path, "c.yaml", "t.yaml"))
    assert after.as_built.cameras["front"].lens == before.cameras["front"].lens
    assert after.simulator is not None
    assert after.simulator.board == before.board.placement


def test_a_rig_without_calibrations_is_its_file_verbatim() -> None:
    assert loader.text("mock") == loader.path_of("mock").read_text(encoding="utf-8")
    assert loader.read("mock").yaml == loader.text("mock")
    assert loader.read("mock").calibrations == ()


def test_the_used_calibrations_are_kept_verbatim(tmp_path: Path) -> None:
    write(camera_file(), tmp_path / "c.yaml")
    file = _rig(tmp_path, "c.yaml")
    rig = loader.read(file)
    (calibration,) = rig.calibrations
    assert rig.text == loader.text(file) == file.read_text()
    assert (calibration.name, calibration.kind) == ("c.yaml", "camera")
    assert calibration.text == (tmp_path / "c.yaml").read_text()
    assert len(calibration.sha256) == 64


def _identity(**changed: Any) -> calibration_schema.CameraIdentity:
    return camera_file().camera.model_copy(update=changed)


@pytest.mark.parametrize(
    ("found", "where", "value", "expected"),
    [
        (
            camera_file(camera=_identity(width_px=1280)),
            "camera, width_px",
            "1280",
            "640, as cameras, front of rig mock",
        ),
        (camera_file(camera=_identity(height_px=960)), "camera, height_px", "960", "480"),
        (camera_file(camera=_identity(name="frnt")), "camera, name", "frnt", "did you mean front"),
        (camera_file(camera=_identity(driver="opencv")), "camera, driver", "opencv", "another camera's calibration"),
        (camera_file(camera=_identity(device="mock1")), "camera, device", "mock1", "mock0"),
        (
            tool_file(board=CheckerboardPattern(squares_x=7, squares_y=6, square_mm=9.0)),
            "board, square_mm",
            "9",
            "8",
        ),
        (
            tool_file(board=CheckerboardPattern(squares_x=10, squares_y=6, square_mm=8.0)),
            "board, squares_x",
            "10",
            "7",
        ),
    ],
)
def test_a_calibration_of_something_else_is_refused_with_its_line(
    tmp_path: Path, found: calibration_schema.CalibrationFile, where: str, value: str, expected: str
) -> None:
    path = write(found, tmp_path / "c.yaml")
    with pytest.raises(BadInputError) as caught:
        loader.load(_rig(tmp_path, "c.yaml"))
    (problem,) = caught.value.problems
    assert problem.file == str(path)
    assert problem.line > 0
    assert problem.where == where
    assert problem.value == value
    assert expected in str(problem)


def test_a_camera_with_another_serial_number_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(camera_file(camera=_identity(serial="A1")), tmp_path / "c.yaml")
    monkeypatch.setattr("rig.config.sections.CameraConfig.serial", lambda camera: "B2")
    with pytest.raises(BadInputError, match="B2, the serial number of the camera that is plugged in"):
        loader.load(_rig(tmp_path, "c.yaml"))


def test_the_serial_number_is_that_of_the_usb_device(tmp_path: Path) -> None:
    usb = tmp_path / "usb1" / "1-2"
    (usb / "1-2:1.0").mkdir(parents=True)
    (usb / "serial").write_text("SN-77\n")
    (tmp_path / "video3").mkdir()
    (tmp_path / "video3" / "device").symlink_to(usb / "1-2:1.0")
    camera = loader.load("mock").cameras["front"]
    assert serial_of(camera.model_copy(update={"device": "/dev/video3"}), tmp_path) == "SN-77"
    assert serial_of(camera.model_copy(update={"device": 4}), tmp_path) is None


def test_two_calibrations_of_one_thing_are_refused(tmp_path: Path) -> None:
    write(camera_file(), tmp_path / "a.yaml")
    write(camera_file(), tmp_path / "b.yaml")
    with pytest.raises(BadInputError, match=r"each thing calibrated by one file.*a\.yaml"):
        loader.load(_rig(tmp_path, "a.yaml", "b.yaml"))


def test_a_missing_calibration_is_reported_at_its_line_of_the_rig_file(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"my\.yaml:\d+:\d+: calibrations #1\n  found     nowhere\.yaml"):
        loader.load(_rig(tmp_path, "nowhere.yaml"))


def test_faults_of_every_calibration_are_reported_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("kind: camera\n")
    (tmp_path / "b.yaml").write_text("kind: tol\n")
    with pytest.raises(BadInputError) as caught:
        loader.load(_rig(tmp_path, "a.yaml", "b.yaml"))
    assert {Path(problem.file).name for problem in caught.value.problems} == {"a.yaml", "b.yaml"}


def dlt_file(folder: Path) -> Path:
    """A DLT calibration of the mock rig's camera, from points that it would see where the rig states it."""
    camera = loader.load("mock").cameras["front"]
    world = np.random.default_rng(3).uniform((-0.08, -0.05, 0.12), (0.08, 0.05, 0.24), (15, 3))
    seen = camera_in_base(camera).inverse().apply(world)
    pixels = lens_of(camera).project(seen, np.zeros(3), np.zeros(3))
    rows = [
        f"{k},{1e3 * x},{1e3 * y},{1e3 * z},front,{u},{v}"
        for k, ((x, y, z), (u, v)) in enumerate(zip(world, pixels, strict=True))
    ]
    points, to = folder / "points.csv", folder / "d.yaml"
    points.write_text("point,X_mm,Y_mm,Z_mm,camera,u_px,v_px\n" + "\n".join(rows))
    done = invoke("calibrate", "dlt", points, "--rig", "mock", "--to", to)
    assert done.exit_code == 0, done.output
    return to


def test_a_dlt_in_the_rods_frame_places_the_camera_and_the_simulated_one_stays(tmp_path: Path) -> None:
    camera = loader.load("mock").cameras["front"]
    dlt_file(tmp_path)
    after = loader.load(_rig(tmp_path, "d.yaml"))
    stated, found = camera.placement, after.cameras["front"].placement
    assert found.translation_mm == pytest.approx(stated.translation_mm, abs=1e-3)
    assert after.simulator is not None
    stands = rigid(found) @ rigid(after.simulator.error_of("front"))
    assert stands.translation_m == pytest.approx(camera_in_base(camera).translation_m, abs=1e-9)
    write(camera_file(), tmp_path / "c.yaml")
    with pytest.raises(BadInputError, match="the place was found through another lens"):
        loader.load(_rig(tmp_path, "c.yaml", "d.yaml"))


def test_a_dlt_whose_world_is_a_board_is_refused(tmp_path: Path) -> None:
    test_a_dlt_in_the_rods_frame_places_the_camera_and_the_simulated_one_stays(tmp_path)
    text = (tmp_path / "d.yaml").read_text().replace("world: rod base", "world: board")
    (tmp_path / "d.yaml").write_text(text)
    with pytest.raises(BadInputError, match=r"d\.yaml:\d+:\d+: world\n  found     board\n  expected  rod base"):
        loader.load(_rig(tmp_path, "d.yaml"))
