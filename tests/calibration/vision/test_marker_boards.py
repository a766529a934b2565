"""Boards with markers are printed as OpenCV prints them, and give an honest covariance when partly hidden."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.support.boards import BOARDS, LENS, TIP_IN_BOARD, Occlusion, measure, ours, patches, poses, printed
from calibration.vision.board import Board
from calibration.vision.charuco import CharucoBoard
from calibration.vision.tag_grid import TagGrid
from calibration.vision.tracker import BoardTracker
from calibration.vision.transforms import RigidTransform
from rig.simulator.board_rendering import print_table, table_renderer
from runs.records import DetectionStatus
from tests.support.vision_bench import BOARD, facing, scene, still

MOST = Occlusion(-0.3, -0.3, 0.95, 1.3)


@pytest.mark.parametrize("board", [CharucoBoard(6, 5, 0.01, 0.0075), TagGrid(3, 2, 0.016, 0.004)])
def test_a_board_is_printed_as_opencv_prints_it(board: Board) -> None:
    drawn, table = printed(board), board.printed
    scale = drawn.shape[1] / board.extent[0]
    x, y = (((lines[1:] + lines[:-1]) / 2 * scale).astype(int) for lines in (table.across, table.down))
    assert np.array_equal(drawn[np.ix_(y, x)] < 128, table.dark)


def test_the_kernel_for_any_print_draws_a_checkerboard_as_the_checkerboards_own_does() -> None:
    own, other = scene(), scene()
    other.board.render = table_renderer(*print_table(BOARD))
    pose = facing(roll_deg=20)
    # At a crossing of lines of which one parts nothing, one kernel samples the cell and the other integrates over it.
    assert np.abs(still(pose, 0, own).astype(int) - still(pose, 0, other)).max() <= 1


@pytest.mark.parametrize("name", ["charuco 6x5", "tags"])
@pytest.mark.parametrize("roll_deg", [0, 100, 200])
def test_corners_have_the_boards_order_for_any_rotation(name: str, roll_deg: float) -> None:
    board, pose = BOARDS[name], facing(roll_deg=roll_deg)
    found = board.find(ours(board, None, 1)(pose, 0))
    assert found is not None
    exact = LENS.project(board.corners_m, cv2.Rodrigues(pose.rotation)[0].ravel(), pose.translation_m)
    assert np.abs(found - exact).max() < 3.0


@pytest.mark.slow
def test_with_a_third_covered_the_stated_intervals_hold_the_truth_and_are_wider() -> None:
    board, where = BOARDS["charuco 9x8"], list(poses(40, 2))
    whole = measure(board, where, (None,), lambda occlusion: ours(board, occlusion, 1))
    covered = measure(board, where, patches(2)[:5], lambda occlusion: ours(board, occlusion, 1))
    assert covered.lost <= 1
    # Three standard deviations of 120 axes, of which three share a pose, below 95 %.
    assert covered.held()[0] > 0.85
    # Foreign corners that spoil the others' edges cost 2.4 times, where the corners that are left allow 1.5 times.
    assert covered.sizes()[0] < 2.0 * whole.sizes()[0]
    assert 1.2 < covered.rms_bound() / whole.rms_bound() < 1.6
    assert np.nanmean(np.trace(covered.covariance_m2, axis1=1, axis2=2)) > np.nanmean(
        np.trace(whole.covariance_m2, axis1=1, axis2=2)
    )


@pytest.mark.parametrize("name", ["charuco 6x5", "tags"])
def test_a_board_that_is_hidden_but_for_a_rim_gives_no_measurement(name: str) -> None:
    board = BOARDS[name]
    detection = BoardTracker(board, LENS).detect(ours(board, MOST, 1)(facing(), 0))
    assert detection.status is DetectionStatus.NO_BOARD


def test_a_board_a_square_beside_is_refused() -> None:
    """The squares of a ChArUco board look alike; its markers do not."""
    board, right = BOARDS["charuco 6x5"], facing()
    beside = RigidTransform(right.rotation, right.apply(np.array([0.01, 0.01, 0.0])))
    picture = ours(board, None, 1)(right, 0)
    for pose, agrees in ((right, True), (beside, False)):
        vector = cv2.Rodrigues(pose.rotation)[0].ravel()
        points = LENS.project(board.check_points_m, vector, pose.translation_m)
        assert board.agrees(picture, points) is agrees


@pytest.mark.parametrize("name", ["charuco 6x5", "tags"])
def test_a_moving_board_is_followed_while_a_hand_crosses_it(name: str) -> None:
    board = BOARDS[name]
    draw, tracker = ours(board, None, 1), BoardTracker(board, LENS)
    for k in range(8):
        pose = facing(0.02 * np.sin(0.3 * k), roll_deg=5.0 * k)
        picture = draw(pose, k)
        middle = LENS.project(np.zeros((1, 3)), cv2.Rodrigues(pose.rotation)[0].ravel(), pose.translation_m)[0]
        cv2.circle(picture, (int(middle[0]) - 60 + 10 * k, int(middle[1]) - 60), 25, 120, -1)
        found = tracker.detect(picture).pose
        assert found is not None
        assert np.linalg.norm(found.point(TIP_IN_BOARD)[0] - pose.apply(TIP_IN_BOARD)) < 1e-3
