"""A replay sees in the stored pictures what the run saw, and what other parameters would have made of it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import runs
from protocols import BadInputError
from rig.config import loader
from rig.config.optics import board_of
from rig.experiment.replay import replay
from rig.observation.overlay import OverlayProjector
from runs.archive import schema
from runs.archive.writer import ArchiveError
from runs.columns import Pressure
from runs.columns.declaration import Column
from runs.run import Run
from tests.support.changed_archive import changed
from tests.support.virtual_runs import protocol_file, virtual_run

pytestmark = pytest.mark.slow


def recorded(folder: Path, encoding: str, free: tuple[str, ...] = ()) -> Run:
    rig = folder / "rig.yaml"
    text = loader.text("mock")
    rig.write_text(f"{text}\nrecording: {{keep_every: 1, encoding: {encoding}, jpeg_quality: 95}}\n")
    protocol = protocol_file(folder, "  - ramp: {actuators: [1], to_bar: 0.4, duration_s: 2}\n")
    return virtual_run(protocol, rig, folder=folder / encoding, seed=3, adapt=bool(free), free=free, note="wet day")


@pytest.fixture(scope="module")
def lossless(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run whose every frame was kept without loss."""
    return recorded(tmp_path_factory.mktemp("lossless"), "png")


def test_lossless_pictures_give_the_stored_tips_again(lossless: Run, tmp_path: Path) -> None:
    again = runs.open(replay(lossless, tmp_path))
    np.testing.assert_array_equal(again.tip.frame, lossless.tip.frame)
    np.testing.assert_allclose(again.tip.measured_mm, lossless.tip.measured_mm, atol=1e-9)
    np.testing.assert_allclose(again.tip.model_mm, lossless.tip.model_mm, atol=1e-6)
    np.testing.assert_allclose(again.pressure.measured_bar, lossless.pressure.measured_bar, rtol=1e-12)
    np.testing.assert_array_equal(again.pressure.time_s, lossless.pressure.time_s)


@pytest.fixture
def humidity(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A column of the control cycles that is declared, and nothing else."""
    column = Column(
        "humidity",
        unit="%",
        about="of the air",
        convert=lambda share: share * 100,
        inverse=lambda percent: percent / 100,
    )
    column.__set_name__(Pressure, "humidity_percent")
    monkeypatch.setattr(Pressure, "humidity_percent", column, raising=False)
    schema.schema.cache_clear()
    yield
    schema.schema.cache_clear()


def test_a_column_of_the_control_cycles_that_the_replay_does_not_name_is_in_it(
    lossless: Run, humidity: None, tmp_path: Path
) -> None:
    copy = Path(shutil.copy(lossless.path, tmp_path / "copy.h5"))
    percent = np.linspace(40, 50, len(lossless.pressure.time_s))
    with changed(copy) as file:
        file["entry/pressure/humidity_percent"] = percent
        file["entry/pressure/humidity_percent"].attrs["units"] = "%"
    again = runs.open(replay(Run(copy), tmp_path))
    np.testing.assert_allclose(again.pressure.values["humidity_percent"], percent, rtol=1e-12)


def test_corners_tips_and_backbone_stand_where_they_are_in_the_stored_pictures(lossless: Run) -> None:
    parsed = loader.recorded(lossless.header, lossless.path).config
    name = next(iter(parsed.cameras))
    projector, frames, backbone = OverlayProjector(parsed, name), lossless.frames, lossless.backbone
    assert backbone is not None
    for k in range(0, len(frames.index), 20):
        image = np.asarray(cv2.imdecode(np.frombuffer(lossless.picture(k), np.uint8), 0), np.uint8)
        found = board_of(parsed).find(image)
        assert found is not None
        assert np.abs(frames.corners_px[k] - found).max() < 0.5
        row = int(np.searchsorted(lossless.tip.frame, frames.index[k]))
        for drawn, point_mm in (
            (frames.tip_px[k], lossless.tip.measured_mm[row]),
            (frames.model_px[k], lossless.tip.model_mm[row]),
            (frames.backbone_px[k][5], backbone.model_mm[row][5]),
        ):
            np.testing.assert_allclose(drawn, projector.pixels(np.asarray([point_mm], float) * 1e-3)[0], atol=1e-3)


def test_a_replay_names_its_parent(lossless: Run, tmp_path: Path) -> None:
    again = runs.open(replay(lossless, tmp_path)).header
    assert again.parent == lossless.header.run_id
    assert again.run_id != lossless.header.run_id
    assert again.simulated
    assert again.notes.startswith("wet day; replayed ")


def test_a_rig_with_other_actuators_is_refused(lossless: Run, tmp_path: Path) -> None:
    text = loader.text("mock-ideal")
    for three, two in (
        ("actuators: [2, 3]", "actuators: [2]"),
        ("  - {actuator: 3, card: daq, channel: 2}\n", ""),
        ("actuator_angles_deg: [0, 120, 240]", "actuator_angles_deg: [0, 180]"),
    ):
        assert text.count(three) == 1
        text = text.replace(three, two)
    (tmp_path / "two.yaml").write_text(text)
    with pytest.raises(BadInputError, match="a rig with 3 actuators, as the run had"):
        replay(lossless, tmp_path, str(tmp_path / "two.yaml"))


def test_jpeg_pictures_give_the_stored_tips_within_two_hundredths_of_a_millimetre(tmp_path: Path) -> None:
    run = recorded(tmp_path, "jpeg", free=("shear_ratio",))
    again = runs.open(replay(run, tmp_path))
    # A replay estimates nothing, whatever the run did.
    assert run.adaptation is not None
    assert again.adaptation is None
    off = again.tip.measured_mm - run.tip.measured_mm
    assert np.linalg.norm(off, axis=1).mean() < 0.02
    # Along the line of sight a single frame sees less sharply: its own standard uncertainty is 0.1 mm there.
    assert np.abs(off[:, [0, 2]]).max() < 0.02
    assert np.abs(off[:, 1]).max() < 0.05


def test_another_variant_moves_the_model_and_not_the_measurement(lossless: Run, tmp_path: Path) -> None:
    again = runs.open(replay(lossless, tmp_path, variant="homogeneous"))
    assert again.header.model_variant == "homogeneous"
    np.testing.assert_allclose(again.tip.measured_mm, lossless.tip.measured_mm, atol=1e-9)
    assert np.abs(again.tip.model_mm - lossless.tip.model_mm).max() > 1.0


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("entry/model/variant", "rigid", r"entry/model/variant: found 'rigid', expected one of"),
        ("entry/frames/image", b"", r"entry/frames/image\[0\]: found 0 bytes, expected a JPEG or PNG"),
        ("entry/frames/image", b"no picture", r"entry/frames/image\[0\]: found 10 bytes, expected a JPEG or PNG"),
    ],
)
def test_a_run_that_cannot_be_replayed_is_refused_with_the_reason(
    lossless: Run, tmp_path: Path, path: str, value: str | bytes, said: str
) -> None:
    copy = Path(shutil.copy(lossless.path, tmp_path / "copy.h5"))
    with changed(copy) as file:
        if isinstance(value, bytes):
            file[path][0] = np.frombuffer(value, np.uint8)
        else:
            file[path][()] = value
    with pytest.raises(ArchiveError, match=rf"copy\.h5: {said}"):
        replay(Run(copy), tmp_path)
