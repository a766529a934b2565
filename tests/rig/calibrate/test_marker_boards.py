"""`rig calibrate` with the board of the rig file: ChArUco boards and grids of tags, of which a part may be seen."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.camera import calibrate_views
from calibration.corner_search import seen_corners
from calibration.views import View
from calibration.vision.board import Board
from calibration.vision.charuco import CharucoBoard
from calibration.vision.tag_grid import TagGrid
from calibration.vision.transforms import RigidTransform
from rig.config.calibration_files import read
from rig.config.loader import load
from rig.config.optics import board_of, camera_in_base, lens_of
from rig.simulator.scene import ImageDegradation, Scene
from tests.support.command_line import invoke
from tests.support.vision_bench import FACING, LENS, SIZE, scene

STEREO = Path(__file__).parents[3] / "rig" / "rigs" / "mock-stereo.yaml"
CHECKERBOARD = "  squares_x: 7\n  squares_y: 6\n  square_mm: 8\n"
CHARUCO = "  kind: charuco\n  squares_x: 6\n  squares_y: 5\n  square_mm: 16\n  marker_mm: 12\n"
TAGS = "  kind: apriltag\n  tags_x: 3\n  tags_y: 2\n  tag_mm: 24\n  gap_mm: 6\n"


def _views(board: Board, count: int, reach_m: tuple[float, float], seed: int) -> Iterator[View]:
    view, rng = scene(ImageDegradation(0.6, 2.0), board=board), np.random.default_rng(seed)
    for k in range(count):
        turn = RigidTransform.from_vectors(np.deg2rad(rng.uniform(-32, 32, 3) * (1, 1, 3)), (0, 0, 0)).rotation
        x, y = rng.uniform(-1, 1, 2) * reach_m
        pose = RigidTransform(turn @ FACING, np.array([x, y, rng.uniform(0.38, 0.45)]))
        yield View(f"{k:02}", view.render(pose, pose, pose, k), "")


@pytest.mark.parametrize(
    ("board", "reach_m"),
    [(CharucoBoard(8, 6, 0.02, 0.015), (0.13, 0.1)), (TagGrid(4, 3, 0.03, 0.009), (0.1, 0.07))],
    ids=["charuco", "tags"],
)
def test_views_that_show_a_part_of_the_board_give_the_lens_within_its_stated_uncertainty(
    board: Board, reach_m: tuple[float, float]
) -> None:
    found = calibrate_views(_views(board, 14, reach_m, 3), board)
    counts = [len(view.corners.which) for view in found.views]
    assert len(counts) > 10
    assert min(counts) < 0.8 * len(board.corners_m)
    off = (found.parameters - np.array([900, 900, 320, 240, *LENS.distortion])) / found.std
    assert np.abs(off[:4]).max() < 4
    assert found.parameters[0] == pytest.approx(900, rel=0.003)
    assert found.rms_px < 0.1


def _stereo_rig(folder: Path, board: str) -> str:
    text = STEREO.read_text()
    assert CHECKERBOARD in text
    (folder / "bench.yaml").write_text(text.replace(CHECKERBOARD, board))
    return "bench.yaml"


def _stereo_views(folder: Path, file: str, count: int = 6) -> None:
    """Pictures of the rig's board, held at places that leave some of it outside a picture."""
    config, rng = load(file), np.random.default_rng(7)
    board = board_of(config)
    for name, camera in config.cameras.items():
        (folder / name).mkdir()
        lens, place = lens_of(camera), camera_in_base(camera)
        view, rng = Scene(board, lens, SIZE, ImageDegradation(0.6, 2.0), 1), np.random.default_rng(7)
        upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
        for k in range(count):
            turn = RigidTransform.from_vectors(rng.uniform(-0.35, 0.35, 3), (0, 0, 0)).rotation
            stands = RigidTransform(turn @ upright, np.array([0, 0, 0.2]) + rng.uniform(-1, 1, 3) * (0.13, 0.03, 0.08))
            pose = place.inverse() @ stands
            assert cv2.imwrite(str(folder / name / f"view{k}.png"), view.render(pose, pose, pose, k))


@pytest.mark.slow
@pytest.mark.parametrize(("board", "edge_mm"), [(CHARUCO, 16), (TAGS, 24)], ids=["charuco", "tags"])
def test_cameras_are_placed_from_views_of_the_rigs_board(here: Path, board: str, edge_mm: float) -> None:
    file = _stereo_rig(here, board)
    _stereo_views(here, file)
    done = invoke("calibrate", "dlt", "left=left", "right=right", "--rig", file, "--to", "d.yaml", "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    (pair,) = facts["pairs"]
    assert pair["baseline_mm"] == pytest.approx(400, abs=4 * pair["baseline_std_mm"])
    assert pair["baseline_std_mm"] < 1
    assert facts["test_error"]["edge_mm"] == pytest.approx(edge_mm, rel=2e-3)
    assert facts["test_error"]["rms_mm"] < 0.1
    found = read(here / "d.yaml").found
    assert found.board == load(file).board.pattern
    corners = len(board_of(load(file)).corners_m)
    assert min(view.corners for view in found.views) < corners
    table = invoke("calibrate", "dlt", "left=left", "right=right", "--rig", file, "--to", "e.yaml")
    assert f"({edge_mm} stated)" in table.output


def test_a_tool_calibration_of_another_marker_board_is_refused_with_its_line(here: Path) -> None:
    file = _stereo_rig(here, CHARUCO)
    assert (
        invoke("calibrate", "tool", "--capture", "--rig", file, "--camera", "left", "--to", "tool.yaml").exit_code == 0
    )
    other = here / "other.yaml"
    other.write_text(f"calibrations: [tool.yaml]\n{(here / file).read_text()}")
    assert load(str(other)).board.placement.translation_mm == pytest.approx((0, 0, 35), abs=0.5)
    other.write_text(other.read_text().replace("marker_mm: 12", "marker_mm: 11"))
    refused = invoke("check", "ramp-a", "--rig", str(other))
    assert refused.exit_code == 2
    assert "tool.yaml:" in refused.output
    assert "board, marker_mm" in refused.output
    assert "11, as the board of rig" in refused.output
    other.write_text(other.read_text().replace(CHARUCO.replace("12", "11"), TAGS))
    assert "a apriltag, as the board" in invoke("check", "ramp-a", "--rig", str(other)).output


def test_a_board_with_other_markers_is_reported_with_what_to_compare(here: Path) -> None:
    (here / "views").mkdir()
    for view in _views(CharucoBoard(6, 5, 0.02, 0.015, "5X5_50"), 4, (0.02, 0.02), 1):
        cv2.imwrite(str(here / "views" / f"{view.name}.png"), view.image)
    done = invoke("calibrate", "camera", "views", "--rig", _stereo_rig(here, CHARUCO))
    assert done.exit_code == 2
    assert "0 of 4 views show a ChArUco board of 6x5 squares with markers 4X4_50" in done.output
    assert "its family of markers and its first marker" in done.output


def test_without_a_board_in_the_rig_the_checkerboard_must_be_stated(here: Path) -> None:
    done = invoke("calibrate", "camera", ".", "--rig", "mock-no-camera")
    assert done.exit_code == 2
    assert "--rig alone, for the board of a rig" in done.output


def test_the_corners_that_two_pictures_share_are_matched_by_the_board() -> None:
    board = CharucoBoard(8, 6, 0.02, 0.015)
    view = scene(board=board)
    left, right = (RigidTransform(FACING, np.array([x, 0.0, 0.4])) for x in (-0.13, 0.13))
    found = [seen_corners(board, view.render(pose, pose, pose, 0)) for pose in (left, right)]
    here, there = found[0].shared(found[1])
    assert 0 < len(here) < min(len(one.which) for one in found)
    apart = there - here
    assert np.abs(apart - apart.mean(axis=0)).max() < 40
    assert apart.mean(axis=0) == pytest.approx((585, 0), abs=60)
