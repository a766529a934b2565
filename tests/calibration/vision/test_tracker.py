"""A trustworthy pose in every picture, or the reason why there is none."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.vision.checkerboard import Checkerboard
from calibration.vision.corners import Corners
from calibration.vision.tracker import BoardTracker
from calibration.vision.transforms import RigidTransform
from rig.simulator.scene import ImageDegradation
from runs.records import DetectionStatus
from tests.support.vision_bench import BOARD, LENS, facing, scene, still


def _corners(pose: RigidTransform, board: Checkerboard = BOARD) -> np.ndarray:
    vector, _ = cv2.Rodrigues(pose.rotation)
    return LENS.project(board.corners_m, np.asarray(vector, dtype=np.float64), pose.translation_m)


def _off_mm(tracker_pose: RigidTransform, true: RigidTransform) -> float:
    return float(np.linalg.norm(tracker_pose.translation_m - true.translation_m)) * 1e3


@pytest.mark.parametrize("roll_deg", [0, 45, 90, 135, 180, 225, 270, 315])
def test_corners_have_the_boards_order_for_any_rotation(roll_deg: float) -> None:
    pose = facing(roll_deg=roll_deg)
    found = BOARD.find(still(pose))
    assert found is not None
    assert np.abs(found - _corners(pose)).max() < 2.0


@pytest.mark.parametrize("size", [(7, 6), (6, 7), (5, 8), (9, 4)])
def test_boards_of_either_parity_are_found(size: tuple[int, int]) -> None:
    board = Checkerboard(*size, 0.008)
    pose = facing(roll_deg=-100)
    found = board.find(still(pose, view=scene(board=board)))
    assert found is not None
    assert np.abs(found - _corners(pose, board)).max() < 2.0


def test_a_moving_board_is_followed() -> None:
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    for k in range(60):
        a = 0.25 * k
        pose = facing(0.05 * np.sin(a), 0.01 * np.cos(a), roll_deg=30 * np.sin(0.7 * a))
        sighting = tracker.detect(still(pose, k, view))
        assert sighting.status is DetectionStatus.MEASURED
        assert sighting.pose is not None
        assert _off_mm(sighting.pose.rigid, pose) < 0.5


@pytest.mark.parametrize("slip", [(0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (-1, 1), (0, -2)])
def test_a_grid_shifted_by_a_square_is_refused(slip: tuple[int, int]) -> None:
    """A larger print of the same squares offers the same corners one square further: reprojection cannot tell."""
    right = facing()
    slipped = RigidTransform(right.rotation, right.apply(np.array([slip[0] * 0.008, slip[1] * 0.008, 0.0])))
    vector, _ = cv2.Rodrigues(slipped.rotation)
    points = LENS.project(BOARD.check_points_m, np.asarray(vector, dtype=np.float64), slipped.translation_m)
    assert not BOARD.agrees(still(right), points)


def test_the_tracker_does_not_slip_when_the_board_jumps_by_a_square() -> None:
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    for k in range(3):
        assert tracker.detect(still(facing(), k, view)).status is DetectionStatus.MEASURED
    for k, step in enumerate((0.008, -0.008, 0.016, 0.0, 0.012), start=3):
        pose = facing(x_m=step)
        sighting = tracker.detect(still(pose, k, view))
        assert sighting.pose is not None
        assert _off_mm(sighting.pose.rigid, pose) < 0.5


def test_a_board_that_leaves_and_returns_is_detected_again() -> None:
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    assert tracker.detect(still(facing(), 0, view)).status is DetectionStatus.MEASURED
    for k in range(1, 4):
        gone = tracker.detect(still(facing(x_m=1.0), k, view))
        assert gone.status is DetectionStatus.NO_BOARD
        assert gone.pose is None
        assert gone.corners is None
    back = facing(-0.06, 0.02, roll_deg=20)
    sighting = tracker.detect(still(back, 4, view))
    assert sighting.pose is not None
    assert _off_mm(sighting.pose.rigid, back) < 0.5


def _hand(picture: np.ndarray) -> None:
    u, v = _corners(facing()).mean(axis=0).astype(int)
    cv2.circle(picture, (int(u) + 30, int(v) + 20), 40, 120, -1)


def _corner_covered(picture: np.ndarray) -> None:
    u, v = _corners(facing())[-1].astype(int)
    picture[v - 4 : v + 22, u - 4 : u + 22] = 200


def _glare(picture: np.ndarray) -> None:
    u, v = _corners(facing())[7].astype(int)
    cv2.circle(picture, (int(u), int(v)), 22, 255, -1)


def _darkness(picture: np.ndarray) -> None:
    picture[:] = picture // 32


def _ink(picture: np.ndarray) -> None:
    """One outer square painted over."""
    pose = facing()
    vector, _ = cv2.Rodrigues(pose.rotation)
    centre = LENS.project(BOARD.at(np.array([0.5]), np.array([0.5])), vector, pose.translation_m)[0]
    cv2.circle(picture, (int(centre[0]), int(centre[1])), 7, 230, -1)


@pytest.mark.parametrize("spoil", [_hand, _corner_covered, _glare, _darkness, _ink])
@pytest.mark.parametrize("tracking", [False, True])
def test_a_spoilt_picture_gives_no_measurement(spoil: object, tracking: bool) -> None:
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    if tracking:
        for k in range(3):
            assert tracker.detect(still(facing(), k, view)).status is DetectionStatus.MEASURED
    picture = still(facing(), 9, view)
    spoil(picture)  # type: ignore[operator]
    sighting = tracker.detect(picture)
    assert sighting.status in (DetectionStatus.NO_BOARD, DetectionStatus.AMBIGUOUS, DetectionStatus.POOR_FIT)
    assert sighting.pose is None
    again = tracker.detect(still(facing(), 10, view))
    assert again.status is DetectionStatus.MEASURED


def test_pictures_without_structure_give_no_measurement() -> None:
    tracker = BoardTracker(BOARD, LENS)
    rng = np.random.default_rng(0)
    flat = np.full((480, 640), 128, np.uint8)
    noise = rng.integers(0, 255, (480, 640), dtype=np.uint8)
    assert tracker.detect(flat).status is DetectionStatus.NO_BOARD
    assert tracker.detect(noise).status is DetectionStatus.NO_BOARD


def test_a_cornerless_picture_that_leaves_every_seed_in_place_is_not_a_perfect_fit() -> None:
    """cornerSubPix returns its seeds where it diverges: the residual is then zero, and means nothing."""
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    for k in range(3):
        tracker.detect(still(facing(), k, view))
    assert tracker.detect(np.full((480, 640), 90, np.uint8)).status is DetectionStatus.NO_BOARD


def test_corners_with_an_impossibly_small_residual_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pose, refine = facing(), Checkerboard.refine

    def too_good(board: Checkerboard, image: np.ndarray, seeds: np.ndarray) -> Corners:
        corners = refine(board, image, seeds)
        assert corners is not None
        return replace(corners, px=_corners(pose))

    monkeypatch.setattr(Checkerboard, "refine", too_good)
    assert BoardTracker(BOARD, LENS).detect(still(pose)).status is DetectionStatus.POOR_FIT


def test_fast_motion_is_measured_through_its_blur() -> None:
    """400 mm/s at 8 ms: seven pixels of smear; the position is that of mid-exposure."""
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    step = np.array([0.0032, 0.0, 0.0])
    for k in range(8):
        middle = facing(-0.05 + 0.0133 * k)
        opened = RigidTransform(middle.rotation, middle.translation_m - step / 2)
        closed = RigidTransform(middle.rotation, middle.translation_m + step / 2)
        sighting = tracker.detect(view.render(opened, middle, closed, k))
        assert sighting.pose is not None
        assert _off_mm(sighting.pose.rigid, middle) < 3.0
    assert tracker.detect(still(facing(), 99, view)).status is DetectionStatus.MEASURED


def test_a_colour_picture_is_measured_like_its_grey_one() -> None:
    picture = still(facing())
    colour = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    one, other = BoardTracker(BOARD, LENS).detect(picture), BoardTracker(BOARD, LENS).detect(colour)
    assert one.pose is not None
    assert other.pose is not None
    assert np.allclose(one.pose.translation_m, other.pose.translation_m, atol=1e-9)


def test_a_board_cut_by_the_pictures_edge_is_not_measured() -> None:
    tracker = BoardTracker(BOARD, LENS)
    assert tracker.detect(still(facing(x_m=0.125), view=scene(ImageDegradation(0.6, 2.0)))).pose is None


def _two_boards() -> np.ndarray:
    left, right = still(facing(-0.07), 0), still(facing(0.07), 1)
    return np.ascontiguousarray(np.hstack([left[:, :320], right[:, 320:]]))


def test_with_two_boards_in_view_none_is_measured() -> None:
    assert BOARD.find(still(facing(-0.07))) is not None
    assert BOARD.find(_two_boards()) is None
    assert BoardTracker(BOARD, LENS).detect(_two_boards()).status is DetectionStatus.NO_BOARD


def test_a_followed_board_is_kept_when_a_second_comes_into_view() -> None:
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    for k in range(3):
        assert tracker.detect(still(facing(-0.07), k, view)).status is DetectionStatus.MEASURED
    for _ in range(3):
        sighting = tracker.detect(_two_boards())
        assert sighting.pose is not None
        assert _off_mm(sighting.pose.rigid, facing(-0.07)) < 0.5


@pytest.mark.parametrize("seed", range(4))
def test_a_board_among_clutter_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = facing(rng.uniform(-0.06, 0.06), rng.uniform(-0.03, 0.03), roll_deg=rng.uniform(-180, 180))
    clean = still(pose)
    picture = clean.copy()
    for _ in range(250):
        x, y = rng.integers(0, 640), rng.integers(0, 480)
        w, h = rng.integers(4, 40, 2)
        cv2.rectangle(picture, (int(x), int(y)), (int(x + w), int(y + h)), int(rng.integers(0, 255)), -1)
    vector, _ = cv2.Rodrigues(pose.rotation)
    outline = BOARD.at(np.array([-1.0, 8.0, 8.0, -1.0]), np.array([-1.0, -1.0, 7.0, 7.0]))
    quad = LENS.project(outline, np.asarray(vector, dtype=np.float64), pose.translation_m)
    inside = cv2.fillConvexPoly(np.zeros_like(picture), quad.round().astype(np.int32), 1).astype(bool)
    picture[inside] = clean[inside]
    sighting = BoardTracker(BOARD, LENS).detect(picture)
    assert sighting.pose is not None
    assert _off_mm(sighting.pose.rigid, pose) < 0.5


def test_a_wrong_flip_is_corrected_when_the_picture_resolves_it() -> None:
    """Head-on either side fits; once the board tilts, only one does."""
    view, tracker = scene(), BoardTracker(BOARD, LENS)
    for k, tilt in enumerate(np.linspace(25, -25, 40)):
        pose = facing(tilt_deg=float(tilt))
        sighting = tracker.detect(still(pose, k, view))
        if abs(tilt) > 8:
            assert sighting.pose is not None
            turn = sighting.pose.rigid.rotation @ pose.rotation.T
            assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 1.0
