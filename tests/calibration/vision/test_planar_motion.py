"""Motion in a known plane: what a pose departs from it by, in standard uncertainties of all that is uncertain."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.vision.planar_motion import DEPARTURES, PlaneOfMotion, depart
from calibration.vision.transforms import RigidTransform

NORMAL = np.array([0.6, 0.0, 0.8])
PLANE = PlaneOfMotion(
    normal=NORMAL,
    through_m=np.array([0.01, 0.02, 0.03]),
    offset_std_m=1e-3,
    tilt_std_rad=0.01,
    board_in_tip=RigidTransform.from_vectors((0.1, -0.2, 0.3), (0.002, -0.001, -0.03)),
    camera_in_base=RigidTransform.from_vectors((2.0, 0.5, -0.4), (0.1, -0.7, 0.2)),
)


def board_in_camera(plane: PlaneOfMotion, turn: float, tip_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Where the camera sees the board of a tip that has turned about the plane's normal."""
    tip = RigidTransform.from_vectors(turn * NORMAL, tip_m)
    seen = plane.camera_in_base.inverse() @ tip @ plane.board_in_tip
    return cv2.Rodrigues(seen.rotation)[0].ravel(), seen.translation_m


def departure_of(
    plane: PlaneOfMotion, vector: NDArray[np.float64], place: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offset and two tilts (3,) of a pose out of the plane in standard uncertainties, and derivatives (3, 6)."""
    off, slopes = np.empty(DEPARTURES), np.empty((DEPARTURES, 6))
    depart(plane.arguments, np.ascontiguousarray(vector), np.ascontiguousarray(place), off, slopes)
    return off, slopes


def in_plane(across: float, up: float) -> NDArray[np.float64]:
    """A place in the plane."""
    first = np.array([0.8, 0.0, -0.6])
    return np.asarray(PLANE.through_m + across * first + up * np.cross(NORMAL, first))


def test_a_tip_that_moves_in_the_plane_and_turns_about_its_normal_does_not_depart() -> None:
    departure, _ = departure_of(PLANE, *board_in_camera(PLANE, 0.7, in_plane(0.05, -0.1)))
    assert departure == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_tip_beside_the_plane_departs_by_its_distance_and_one_that_is_tilted_by_its_angle() -> None:
    beside, _ = departure_of(PLANE, *board_in_camera(PLANE, 0.7, in_plane(0.05, -0.1) + 2e-3 * NORMAL))
    assert beside == pytest.approx([2.0, 0, 0], abs=1e-9)
    tilt = RigidTransform.from_vectors(0.03 * np.array([0.8, 0.0, -0.6]), (0, 0, 0))
    tip = RigidTransform(
        tilt.rotation @ RigidTransform.from_vectors(0.7 * NORMAL, (0, 0, 0)).rotation, in_plane(0.05, -0.1)
    )
    seen = PLANE.camera_in_base.inverse() @ tip @ PLANE.board_in_tip
    tilted, _ = departure_of(PLANE, cv2.Rodrigues(seen.rotation)[0].ravel(), seen.translation_m)
    assert tilted[0] == pytest.approx(0.0, abs=1e-9)
    assert np.hypot(*tilted[1:]) == pytest.approx(np.sin(0.03) / 0.01)


TIP_M = in_plane(0.05, -0.1) + 5e-3 * NORMAL
FROM_CAMERA_M = float(np.linalg.norm(TIP_M - PLANE.camera_in_base.translation_m))
FROM_BOARD_M = float(np.linalg.norm(PLANE.board_in_tip.translation_m))


@pytest.mark.parametrize(
    ("part", "std", "adds_m", "adds_rad"),
    [
        ("camera_in_base", {"translation_std_m": 2e-3}, 2e-3, 0.0),
        ("board_in_tip", {"translation_std_m": 2e-3}, 2e-3, 0.0),
        ("camera_in_base", {"rotation_std_rad": 0.004}, 0.004 * FROM_CAMERA_M, 0.004),
        ("board_in_tip", {"rotation_std_rad": 0.05}, 0.05 * FROM_BOARD_M, 0.05),
    ],
)
def test_uncertain_camera_and_board_poses_widen_the_plane_prior(
    part: str, std: dict[str, float], adds_m: float, adds_rad: float
) -> None:
    loose = replace(PLANE, **{part: replace(getattr(PLANE, part), **std)})
    pose = board_in_camera(PLANE, 0.7, TIP_M)
    assert departure_of(loose, *pose)[0][0] == pytest.approx(5e-3 / np.hypot(1e-3, adds_m))
    turned = pose[0] + np.array([0.01, -0.02, 0.015])
    strict_tilt, loose_tilt = (departure_of(plane, turned, pose[1])[0][1:] for plane in (PLANE, loose))
    assert loose_tilt == pytest.approx(strict_tilt * 0.01 / np.hypot(0.01, adds_rad))


def test_the_derivatives_of_the_departure_equal_finite_differences() -> None:
    loose = replace(PLANE, camera_in_base=replace(PLANE.camera_in_base, translation_std_m=1e-3))
    vector, place = board_in_camera(loose, 0.3, in_plane(0.02, 0.01) + 1e-3 * NORMAL)
    pose = np.concatenate([vector + np.array([0.02, 0.01, -0.03]), place])
    _, derivative = departure_of(loose, pose[:3], pose[3:])
    for k, step in enumerate(1e-6 * np.eye(6)):
        above, below = (departure_of(loose, x[:3], x[3:])[0] for x in (pose + step, pose - step))
        assert derivative[:, k] == pytest.approx((above - below) / 2e-6, rel=1e-5, abs=1e-4)
