"""The pose's covariance is honest, and transforms carry it as they must."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.vision.pose import refine, solutions, tip_in_base
from calibration.vision.transforms import RigidTransform
from tests.support.budget import examples
from tests.support.vision_bench import BOARD, LENS, facing

angles = st.tuples(*[st.floats(-3, 3)] * 3)
places = st.tuples(*[st.floats(-2, 2)] * 3)


@examples(60)
@given(angles, places, angles, places, places)
def test_transforms_compose_and_invert(
    a: tuple[float, float, float],
    s: tuple[float, float, float],
    b: tuple[float, float, float],
    t: tuple[float, float, float],
    x: tuple[float, float, float],
) -> None:
    outer, inner, point = RigidTransform.from_vectors(a, s), RigidTransform.from_vectors(b, t), np.array(x)
    assert np.allclose((outer @ inner).apply(point), outer.apply(inner.apply(point)), atol=1e-12)
    assert np.allclose(outer.inverse().apply(outer.apply(point)), point, atol=1e-12)


def test_an_uncertain_transform_scatters_points_as_its_covariance_says() -> None:
    rng = np.random.default_rng(1)
    frame = RigidTransform.from_vectors((0.3, -0.8, 1.1), (0.1, 0.2, 0.3), 0.002, np.deg2rad(0.5))
    point = np.array([0.05, -0.2, 0.4])
    covariance = frame.error_covariance(frame.rotation @ point)[:3, :3]
    samples = []
    for _ in range(4000):
        slip = RigidTransform.from_vectors(rng.normal(0, frame.rotation_std_rad, 3), (0.0, 0.0, 0.0)).rotation
        samples.append(slip @ frame.rotation @ point + frame.translation_m + rng.normal(0, 0.002, 3))
    assert np.allclose(np.cov(np.array(samples).T), covariance, atol=0.08 * np.trace(covariance))


@pytest.mark.parametrize("tilt_deg", [5, 25, 40])
def test_the_pose_covariance_has_its_stated_coverage(tilt_deg: float) -> None:
    rng = np.random.default_rng(int(tilt_deg))
    std, held, trials = 0.05, 0, 400
    tip = np.array([0.0, 0.035, -0.02])
    for _ in range(trials):
        truth = facing(rng.uniform(-0.05, 0.05), rng.uniform(-0.03, 0.03), tilt_deg=tilt_deg, roll_deg=30)
        vector = _vector(truth)
        exact = LENS.project(BOARD.corners_m, vector, truth.translation_m)
        pose = refine(
            BOARD.corners_m,
            exact + rng.normal(0, std, exact.shape),
            LENS,
            (vector, truth.translation_m),
            np.broadcast_to(std**2 * np.eye(2), (len(exact), 2, 2)),
        )
        assert pose is not None
        point, covariance = pose.point(tip)
        error = point - truth.apply(tip)
        held += float(error @ np.linalg.solve(covariance, error)) < 7.815
    assert 0.91 <= held / trials <= 0.985


def _vector(pose: RigidTransform) -> np.ndarray:
    vector, _ = cv2.Rodrigues(pose.rotation)
    return np.asarray(vector, dtype=np.float64).ravel()


def test_a_plane_has_two_poses_and_the_better_one_comes_first() -> None:
    truth = facing(0.02, -0.01, tilt_deg=30)
    exact = LENS.project(BOARD.corners_m, _vector(truth), truth.translation_m)
    found = solutions(BOARD.corners_m, exact, LENS)
    better, worse = found
    assert better.misfit < 1e-6
    assert np.allclose(better.translation_m, truth.translation_m, atol=1e-7)
    assert worse.misfit > 100


def test_a_start_far_off_converges_or_is_refused_and_never_ends_behind_the_camera() -> None:
    truth = facing()
    exact = LENS.project(BOARD.corners_m, _vector(truth), truth.translation_m)
    rng = np.random.default_rng(7)
    for _ in range(50):
        start = (rng.uniform(-3, 3, 3), rng.uniform((-0.3, -0.3, 0.05), (0.3, 0.3, 1.0)))
        pose = refine(BOARD.corners_m, exact, LENS, start)
        assert pose is None or pose.translation_m[2] > 0


def test_the_tip_does_not_depend_on_the_poses_of_board_and_camera() -> None:
    tip_in_base_true = RigidTransform.from_vectors((0.1, 0.5, -0.2), (0.04, 0.001, 0.172))
    board_in_tip = RigidTransform.from_vectors((-1.0, 0.1, 0.2), (0.001, 0.002, 0.035))
    camera_in_base = RigidTransform.from_vectors((1.5, 0.02, -0.03), (0.01, 0.4, 0.2))
    seen = camera_in_base.inverse() @ tip_in_base_true @ board_in_tip
    exact = LENS.project(BOARD.corners_m, _vector(seen), seen.translation_m)
    pose = refine(BOARD.corners_m, exact, LENS, (_vector(seen), seen.translation_m))
    assert pose is not None
    tip, covariance = tip_in_base(pose, board_in_tip, camera_in_base)
    assert np.allclose(tip.translation_m, tip_in_base_true.translation_m, atol=1e-8)
    assert np.allclose(tip.rotation, tip_in_base_true.rotation, atol=1e-7)
    loose = RigidTransform(camera_in_base.rotation, camera_in_base.translation_m, 1e-3, np.deg2rad(0.1))
    _, wider = tip_in_base(pose, board_in_tip, loose)
    assert np.all(np.linalg.eigvalsh((wider - covariance)[:3, :3]) > 0.9e-6)
    assert np.all(np.linalg.eigvalsh((wider - covariance)[3:, 3:]) > 0.9 * np.deg2rad(0.1) ** 2)


def test_the_uncertainty_of_the_mounting_rotates_with_the_tip() -> None:
    tip = RigidTransform.from_vectors((0.1, 0.5, -0.2), (0.04, 0.001, 0.172))
    board = RigidTransform.from_vectors((-1.0, 0.1, 0.2), (0.001, 0.002, 0.035))
    camera = RigidTransform.from_vectors((1.5, 0.02, -0.03), (0.01, 0.4, 0.2))
    seen = camera.inverse() @ tip @ board
    exact = LENS.project(BOARD.corners_m, _vector(seen), seen.translation_m)
    pose = refine(BOARD.corners_m, exact, LENS, (_vector(seen), seen.translation_m))
    assert pose is not None
    loose = RigidTransform(board.rotation, board.translation_m, 1e-3, 0.02)
    adds = tip_in_base(pose, loose, camera)[1] - tip_in_base(pose, board, camera)[1]
    lever = tip.rotation @ board.translation_m
    expected = 1e-6 * np.eye(3) + 0.02**2 * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    assert adds[:3, :3] == pytest.approx(expected, abs=1e-12)
    assert adds[3:, 3:] == pytest.approx(0.02**2 * np.eye(3), abs=1e-12)


def test_position_and_orientation_of_the_tip_scatter_together_as_their_covariance_says() -> None:
    rng, std, trials = np.random.default_rng(3), 0.05, 400
    true_tip = RigidTransform.from_vectors((0.1, 0.9, -0.2), (0.04, 0.001, 0.172))
    board = RigidTransform.from_vectors((-1.0, 0.1, 0.2), (0.001, 0.002, 0.035), 2e-4, np.deg2rad(0.3))
    camera = RigidTransform.from_vectors((1.5, 0.02, -0.03), (0.01, 0.4, 0.2), 1e-4, np.deg2rad(0.1))
    distance2 = []
    for _ in range(trials):
        seen = _slipped(camera, rng).inverse() @ true_tip @ _slipped(board, rng)
        exact = LENS.project(BOARD.corners_m, _vector(seen), seen.translation_m)
        noisy = exact + rng.normal(0, std, exact.shape)
        covariance = np.broadcast_to(std**2 * np.eye(2), (len(exact), 2, 2))
        pose = refine(BOARD.corners_m, noisy, LENS, (_vector(seen), seen.translation_m), covariance)
        assert pose is not None
        tip, stated = tip_in_base(pose, board, camera)
        turn = cv2.Rodrigues(tip.rotation @ true_tip.rotation.T)[0].ravel()
        error = np.concatenate([tip.translation_m - true_tip.translation_m, turn])
        distance2.append(float(error @ np.linalg.solve(stated, error)))
    # Chi-squared with six degrees of freedom.
    assert np.mean(distance2) == pytest.approx(6, rel=0.12)
    assert np.mean(np.array(distance2) < 12.592) == pytest.approx(0.95, abs=0.03)


def _slipped(frame: RigidTransform, rng: np.random.Generator) -> RigidTransform:
    slip = RigidTransform.from_vectors(rng.normal(0, frame.rotation_std_rad, 3), (0.0, 0.0, 0.0)).rotation
    shift = rng.normal(0, frame.translation_std_m, 3)
    return RigidTransform(slip @ frame.rotation, frame.translation_m + shift)
