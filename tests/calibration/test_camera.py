"""Intrinsics from views of a checkerboard: real pictures with a published answer, rendered ones with a known one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.camera import PARAMETERS, CalibrationError, calibrate, calibrate_views
from calibration.views import View, ViewsError, views_in
from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.tag_grid import TagGrid
from calibration.vision.transforms import RigidTransform
from rig.simulator.scene import ImageDegradation
from tests.support.shared_data import shared_data
from tests.support.vision_bench import FACING, LENS, scene

BOARD = Checkerboard(10, 7, 0.016)


def test_real_views_give_the_published_focal_length() -> None:
    found = calibrate(shared_data("chessboard"), Checkerboard(10, 7, 0.025))
    published = 535.92
    fx, fy = found.parameters[:2]
    assert fx == pytest.approx(published, rel=0.01)
    assert fy == pytest.approx(published, rel=0.01)
    assert found.rms_px <= 0.3
    assert len(found.views) == 13
    assert found.advice == ()
    assert all(len(v.sha256) == 64 for v in found.views)


def _rendered(count: int, seed: int = 4) -> Iterator[View]:
    view, rng = scene(ImageDegradation(0.6, 2.0), board=BOARD), np.random.default_rng(seed)
    for k in range(count):
        turn = RigidTransform.from_vectors(np.deg2rad(rng.uniform(-32, 32, 3) * (1, 1, 0.5)), (0, 0, 0)).rotation
        place = rng.uniform((-0.06, -0.035, 0.38), (0.06, 0.035, 0.45))
        pose = RigidTransform(turn @ FACING, place)
        yield View(f"{k:02}", view.render(pose, pose, pose, k), "")


@pytest.fixture(scope="module")
def calibrated() -> object:
    return calibrate_views(_rendered(16), BOARD)


def test_rendered_views_give_the_lens_back_within_its_stated_uncertainty(calibrated: object) -> None:
    found = calibrated
    truth = np.array([900, 900, 320, 240, *LENS.distortion])
    off = (found.parameters - truth) / found.std  # type: ignore[attr-defined]
    assert np.abs(off[:4]).max() < 4, dict(zip(PARAMETERS, off.round(1), strict=True))
    assert found.parameters[0] == pytest.approx(900, rel=0.002)  # type: ignore[attr-defined]
    assert found.rms_px < 0.05  # type: ignore[attr-defined]


def test_the_lens_found_takes_rays_through_pixels_and_back(calibrated: object) -> None:
    lens = calibrated.lens  # type: ignore[attr-defined]
    pixels = np.random.default_rng(0).uniform((20, 20), (620, 460), (50, 2))
    rays = np.column_stack([lens.rays(pixels), np.ones(50)])
    assert np.allclose(lens.project(rays, np.zeros(3), np.zeros(3)), pixels, atol=1e-6)


def _write(folder: Path, views: Iterator[View]) -> Path:
    for view in views:
        cv2.imwrite(str(folder / f"{view.name}.png"), view.image)
    return folder


def test_unusable_views_of_a_folder_are_reported_with_a_remedy(tmp_path: Path) -> None:
    folder = _write(tmp_path, _rendered(5))
    cv2.imwrite(str(folder / "blank.png"), np.full((480, 640), 90, np.uint8))
    found = calibrate(folder, BOARD)
    assert [name for name, _, _ in found.skipped] == ["blank.png"]
    assert "no board" in found.skipped[0][1]
    assert any("at least 10 views" in want for want in found.advice)


@pytest.mark.parametrize(("times", "result"), [(12, "residual"), (25, "no board")])
def test_an_overexposed_view_is_reported_as_one(times: float, result: str) -> None:
    views = list(_rendered(6))
    bright = np.clip(views[2].image.astype(np.float64) * times, 0, 255).astype(np.uint8)
    views[2] = View("bright", bright, "")
    found = calibrate_views(iter(views), BOARD)
    ((name, reason, _),) = found.skipped
    assert name == "bright"
    assert result in reason
    assert "overexposed" in reason


def test_a_view_with_mistaken_corners_is_left_out_with_its_residual() -> None:
    views = list(_rendered(12))
    straight = views[3].image
    y, x = np.mgrid[0:480, 0:640].astype(np.float32)
    wavy = cv2.remap(straight, x + 4 * np.sin(y / 30), y, cv2.INTER_LINEAR)
    views[3] = View("bent", np.asarray(wavy, dtype=np.uint8), "")
    found = calibrate_views(iter(views), BOARD)
    assert [name for name, _, _ in found.skipped] == ["bent"]
    assert "residual" in found.skipped[0][1]
    assert found.rms_px < 0.05


def test_a_video_is_as_good_as_a_folder(tmp_path: Path) -> None:
    file = tmp_path / "views.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"FFV1"), 30, (640, 480))
    if not writer.isOpened():
        pytest.skip("this OpenCV has no FFV1 encoder")
    for view in _rendered(12):
        writer.write(cv2.cvtColor(view.image, cv2.COLOR_GRAY2BGR))
    writer.release()
    assert len(list(views_in(file, every=3))) == 4
    assert calibrate(file, BOARD, every=2).parameters[0] == pytest.approx(900, rel=0.01)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: folder / "missing", "does not exist"),
        (lambda folder: folder, "holds no picture"),
        (lambda folder: (folder / "a.txt").write_text("x") and folder / "a.txt", "neither a folder nor a video"),
        (lambda folder: (folder / "a.avi").write_bytes(b"x") and folder / "a.avi", "not a video"),
        (lambda folder: (folder / "a.png").write_bytes(b"x") and folder, "not a picture"),
    ],
)
def test_sources_without_views_are_named(tmp_path: Path, make: object, message: str) -> None:
    with pytest.raises(ViewsError, match=message):
        calibrate(make(tmp_path), BOARD)  # type: ignore[operator]


def test_a_wrong_count_of_corners_is_explained(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="count the inner corners, not the squares"):
        calibrate(_write(tmp_path, _rendered(4)), Checkerboard(11, 8, 0.016))


def test_views_of_two_sizes_are_refused() -> None:
    views = [*_rendered(2), View("small", np.zeros((240, 320), np.uint8), "")]
    with pytest.raises(CalibrationError, match="small is 320x240"):
        calibrate_views(iter(views), BOARD)


@pytest.mark.parametrize(
    "board",
    [
        Checkerboard(2, 7, 0.02),
        Checkerboard(10, 7, 0.0),
        Checkerboard(10, 7, float("nan")),
        TagGrid(1, 1, 0.04, 0.01),
    ],
    ids=["one row", "no size", "no number", "one tag"],
)
def test_invalid_boards_are_refused(board: Board) -> None:
    with pytest.raises(CalibrationError, match=r"too small|has no size"):
        calibrate_views(iter(()), board)
