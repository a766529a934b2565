"""Direct linear transformation: coefficients from control points, points and poses from several cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.dlt import DLT, DLTError, calibrate, reconstruct
from calibration.multiview_pose import board_pose
from calibration.vision.corners import Corners
from calibration.vision.lens import Lens
from calibration.vision.transforms import RigidTransform
from tests.support.budget import examples
from tests.support.vision_bench import BOARD

LENS = Lens.of(900, 905, 322, 238, (-0.12, 0.08, 0.0004, -0.0003, 0.0))
IDEAL = Lens.of(900, 905, 322, 238)


def _camera(angle_deg: float, distance_m: float = 0.7) -> RigidTransform:
    """A camera that looks at the origin from an angle about the world's y axis."""
    a = np.deg2rad(angle_deg)
    forward = np.array([-np.sin(a), 0.0, np.cos(a)])
    down = np.array([0.0, 1.0, 0.0])
    rotation = np.column_stack([np.cross(down, forward), down, forward])
    return RigidTransform(rotation, -distance_m * forward)


def _pixels(lens: Lens, camera: RigidTransform, points: np.ndarray) -> np.ndarray:
    return lens.project(camera.inverse().apply(points), np.zeros(3), np.zeros(3))


def _cloud(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(-0.1, 0.1, (count, 3))


@examples(40)
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(-80, 80), count=st.integers(6, 40))
def test_exact_pixels_give_the_exact_coefficients(seed: int, angle: float, count: int) -> None:
    points = _cloud(np.random.default_rng(seed), count)
    camera = _camera(angle)
    try:
        found = calibrate(points, _pixels(IDEAL, camera, points))
    except DLTError:
        return  # six points may happen to lie almost in a plane
    other = _cloud(np.random.default_rng(seed + 1), 20)
    assert np.abs(found.project(points) - _pixels(IDEAL, camera, points)).max() < 1e-6
    if count >= 8:
        assert np.abs(found.project(other) - _pixels(IDEAL, camera, other)).max() < 1e-3


def test_distortion_is_removed_before_the_dlt() -> None:
    points, camera = _cloud(np.random.default_rng(1), 30), _camera(25)
    pixels = _pixels(LENS, camera, points)
    with_lens, without = calibrate(points, pixels, LENS), calibrate(points, pixels)
    assert with_lens.rms_px < 1e-6
    assert without.rms_px > 0.05
    assert np.allclose(with_lens.centre_m, camera.translation_m, atol=1e-7)
    assert np.allclose(with_lens.coefficients, DLT.of_camera(LENS, camera).coefficients, rtol=1e-6, atol=1e-9)


def test_refinement_does_not_raise_the_residuals_and_estimates_the_noise() -> None:
    rng = np.random.default_rng(2)
    points, camera = _cloud(rng, 200), _camera(-20)
    noisy = _pixels(IDEAL, camera, points) + rng.normal(0, 0.3, (200, 2))
    found = calibrate(points, noisy)
    freedom = 400 - 11
    assert found.residuals_px.size == 400
    assert np.sum(found.residuals_px**2) / freedom == pytest.approx(0.09, rel=0.2)
    # No neighbour of the solution does better.
    for step in np.diag(np.sqrt(np.diag(found.covariance))):
        for sign in (-0.3, 0.3):
            moved = DLT(found.coefficients + sign * step, found.covariance, found.residuals_px)
            assert np.sum((noisy - moved.project(points)) ** 2) >= np.sum(found.residuals_px**2)


def test_the_coefficients_covariance_is_their_scatter() -> None:
    rng = np.random.default_rng(3)
    points, camera = _cloud(rng, 40), _camera(15)
    exact = _pixels(IDEAL, camera, points)
    runs = [calibrate(points, exact + rng.normal(0, 0.2, exact.shape), std_px=0.2) for _ in range(300)]
    scatter = np.cov(np.array([r.coefficients for r in runs]).T)
    ratio = np.sqrt(np.diag(scatter) / np.diag(runs[0].covariance))
    assert np.all((ratio > 0.8) & (ratio < 1.25)), ratio


def test_points_are_reconstructed_by_two_three_and_four_cameras() -> None:
    rng = np.random.default_rng(4)
    points = _cloud(rng, 25)
    places = [_camera(a) for a in (-30, 30, 0, 60)]
    for count in (2, 3, 4):
        cameras = [DLT.of_camera(LENS, place) for place in places[:count]]
        found = reconstruct(cameras, [_pixels(LENS, place, points) for place in places[:count]])
        assert np.abs(found.m - points).max() < 1e-8
        assert found.residual_px.max() < 1e-5


def test_the_covariance_of_a_point_has_its_stated_coverage() -> None:
    rng = np.random.default_rng(5)
    std = 0.15
    control = _cloud(rng, 30)
    places = [_camera(a) for a in (-30, 30)]
    held = 0.0
    trials = 40
    for _ in range(trials):
        cameras = [
            calibrate(control, _pixels(LENS, p, control) + rng.normal(0, std, (30, 2)), LENS, std_px=std)
            for p in places
        ]
        points = _cloud(rng, 30)
        seen = [_pixels(LENS, p, points) + rng.normal(0, std, (30, 2)) for p in places]
        noise = [np.broadcast_to(std**2 * np.eye(2), (30, 2, 2))] * 2
        found = reconstruct(cameras, seen, noise)
        off = found.m - points
        held += np.mean(np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.covariance), off) < 7.815)
    assert 0.92 < held / trials < 0.975


def test_a_board_is_placed_in_the_world_by_two_cameras_with_an_honest_covariance() -> None:
    rng = np.random.default_rng(6)
    std = 0.05
    places = [_camera(a) for a in (-30, 30)]
    cameras = [DLT.of_camera(LENS, place) for place in places]
    tip = np.array([0.0, 0.03, -0.01])
    inside, errors = 0, []
    for _ in range(200):
        turn = rng.uniform(-0.4, 0.4, 3) + np.array([np.pi, 0, 0])
        board = RigidTransform.from_vectors(turn, rng.uniform(-0.05, 0.05, 3))
        world = board.apply(BOARD.corners_m)
        corners = []
        for place in places:
            pixels = _pixels(LENS, place, world)
            noise = np.broadcast_to(std**2 * np.eye(2), (len(world), 2, 2))
            unknown = np.ones(len(world))
            corners.append(Corners(pixels + rng.normal(0, std, pixels.shape), noise, unknown, unknown))
        pose = board_pose(BOARD.corners_m, cameras, corners)
        assert pose is not None
        point, covariance = pose.point(tip)
        error = point - board.apply(tip)
        errors.append(np.linalg.norm(error))
        inside += float(error @ np.linalg.solve(covariance, error)) < 7.815
    assert 0.90 <= inside / 200 <= 0.99
    assert np.mean(errors) < 0.15e-3


def test_an_error_common_to_all_corners_of_a_camera_is_in_the_pose_covariance() -> None:
    places = [_camera(a) for a in (-30, 30)]
    cameras = [DLT.of_camera(LENS, place) for place in places]
    world = RigidTransform.from_vectors(np.array([np.pi - 0.3, 0.2, 0.1]), np.array([0.02, 0.01, 0.0])).apply(
        BOARD.corners_m
    )
    noise, unknown = np.broadcast_to(0.02**2 * np.eye(2), (len(world), 2, 2)), np.ones(len(world))
    left, right = (Corners(_pixels(LENS, place, world), noise, unknown, unknown) for place in places)
    shift = np.tile([0.05, -0.02], (len(world), 1))
    still = board_pose(BOARD.corners_m, cameras, [left, right])
    told = board_pose(BOARD.corners_m, cameras, [left, replace(right, carried_px=shift)])
    moved = board_pose(BOARD.corners_m, cameras, [left, replace(right, px=right.px + shift)])
    assert still is not None
    assert told is not None
    assert moved is not None
    way = moved.translation_m - still.translation_m
    more = (told.covariance - still.covariance)[3:, 3:]
    assert np.linalg.norm(way) > 20e-6
    assert np.allclose(more, np.outer(way, way), atol=0.05 * way @ way)


@pytest.mark.parametrize(
    ("points", "pixels", "message"),
    [
        (np.zeros((5, 3)), np.zeros((5, 2)), "at least 6"),
        (np.zeros((7, 2)), np.zeros((7, 2)), r"control points \(n, 3\)"),
        (np.zeros((7, 3)), np.zeros((6, 2)), r"control points \(n, 3\)"),
        (np.column_stack([np.random.default_rng(0).uniform(size=(20, 2)), np.zeros(20)]), np.zeros((20, 2)), "plane"),
        (np.full((8, 3), np.nan), np.zeros((8, 2)), "not a number"),
    ],
)
def test_points_that_determine_nothing_are_refused_with_the_reason(
    points: np.ndarray, pixels: np.ndarray, message: str
) -> None:
    with pytest.raises(DLTError, match=message):
        calibrate(points, pixels)


def test_one_camera_cannot_reconstruct_a_point() -> None:
    camera = DLT.of_camera(LENS, _camera(0))
    with pytest.raises(DLTError, match="two cameras"):
        reconstruct([camera], [np.zeros((1, 2))])


def test_two_cameras_in_one_place_give_no_point() -> None:
    camera = DLT.of_camera(IDEAL, _camera(0))
    pixels = np.array([[300.0, 200.0]])
    with pytest.raises(DLTError, match="too close together"):
        reconstruct([camera, camera], [pixels, pixels])
