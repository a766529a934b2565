"""Pose of a board in the world from several cameras by Gauss-Newton."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dlt import DLT, by_points, reconstruct
from calibration.vision.corners import Corners
from calibration.vision.pose import Pose, residual_covariance
from model.arrays import Array

_STEPS = 20
_CONVERGED = 1e-10
# Corners that all cameras must see, for the start.
_LEAST_COMMON = 4


def board_pose(points_m: Array, cameras: Sequence[DLT], corners: Sequence[Corners]) -> Pose | None:
    """Pose of the board in the world from its corners (n, 3) and their images.

    Starts from the reconstructed points that all cameras see, and then minimises the residuals in all pictures
    together. `residuals_px` and `projected_px` of the result hold the cameras one after the other, undistorted. None if
    it does not converge.

    Raises:
        DLTError: fewer than two cameras.
    """
    undistorted = [camera.undistorted(c.px) for camera, c in zip(cameras, corners, strict=True)]
    noise = [_undistorted_noise(camera, c) for camera, c in zip(cameras, corners, strict=True)]
    points = [c.of(points_m) for c in corners]
    common, places = _common(len(points_m), corners)
    if len(common) < _LEAST_COMMON:
        return None
    start = reconstruct(
        cameras,
        [c.px[place] for c, place in zip(corners, places, strict=True)],
        [n[place] for n, place in zip(noise, places, strict=True)],
    )
    rotation, translation = fit_rigid(points_m[common], start.m)
    vector, _ = cv2.Rodrigues(rotation)
    x = np.concatenate([np.asarray(vector, dtype=np.float64).ravel(), translation])
    whiteners = [np.linalg.inv(np.linalg.cholesky(n)) for n in noise]

    def at(values: Array) -> _Linearised:
        projected, slope = _project(points, cameras, values)
        rest = [np.einsum("nij,nj->ni", w, s - p) for w, s, p in zip(whiteners, undistorted, projected, strict=True)]
        white = [np.matmul(w, d) for w, d in zip(whiteners, slope, strict=True)]
        return _Linearised(
            values, np.concatenate(projected), np.concatenate(white).reshape(-1, 6), np.concatenate(rest).ravel()
        )

    found = _gauss_newton(at, x)
    if found is None:
        return None
    covariance = residual_covariance(found.jacobian, found.cost, points, np.array([c.unexplained for c in corners]))
    covariance = _add_common_errors(covariance, found, cameras, corners, points, whiteners)
    residuals = np.concatenate(undistorted) - found.projected
    return Pose(found.x[:3], found.x[3:], np.asarray(covariance), residuals, found.projected, found.cost)


@dataclass(frozen=True)
class _Linearised:
    """A pose x (6,), what it projects (n, 2), and its whitened residuals (2 n,) with their derivatives (2 n, 6)."""

    x: Array
    projected: Array
    jacobian: Array
    residual: Array

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)


def _gauss_newton(at: Callable[[Array], _Linearised], x: Array) -> _Linearised | None:
    """Minimise the sum of squares from x; None if it does not converge."""
    best = at(x)
    for _ in range(_STEPS):
        jacobian = best.jacobian
        trial = at(best.x + np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ best.residual))
        if not np.isfinite(trial.cost):
            return None
        # Without noise the cost is only rounding, and may rise.
        done, improved = abs(best.cost - trial.cost) <= _CONVERGED * max(best.cost, 1.0), trial.cost <= best.cost
        if improved:
            best = trial
        if done:
            return best
        if not improved:
            return None
    return None


def _add_common_errors(
    covariance: Array,
    found: _Linearised,
    cameras: Sequence[DLT],
    corners: Sequence[Corners],
    points: Sequence[Array],
    whiteners: Sequence[Array],
) -> Array:
    """Add to a covariance (6, 6) what all corners of a camera have in common, so that it does not average out.

    These are the errors of its coefficients, and of the transport of its corners to another time.
    """
    jacobian = found.jacobian
    unscaled = np.linalg.inv(jacobian.T @ jacobian)
    rotation = np.asarray(cv2.Rodrigues(found.x[:3])[0])
    by_camera = np.split(jacobian, np.cumsum([2 * len(seen) for seen in points])[:-1])
    for camera, seen_by, whitener, slope, seen in zip(cameras, corners, whiteners, by_camera, points, strict=True):
        world = seen @ rotation.T + found.x[3:]
        shift = np.matmul(whitener, camera.by_coefficients(world).reshape(-1, 2, 11)).reshape(-1, 11)
        gain = unscaled @ slope.T @ shift
        covariance = covariance + gain @ camera.covariance @ gain.T
        if seen_by.carried_px is not None:
            by_carrying = unscaled @ slope.T @ np.einsum("nij,nj->ni", whitener, seen_by.carried_px).ravel()
            covariance = covariance + np.outer(by_carrying, by_carrying)
    return np.asarray(covariance)


def _common(count: int, corners: Sequence[Corners]) -> tuple[NDArray[np.intp], list[NDArray[np.intp]]]:
    """The corners that all cameras see, as numbers of the board and as places in the corners of each camera."""
    seen = [np.arange(count) if c.seen is None else c.seen for c in corners]
    common = functools.reduce(np.intersect1d, seen)
    return common, [np.flatnonzero(np.isin(s, common)) for s in seen]


def _project(points: Sequence[Array], cameras: Sequence[DLT], values: Array) -> tuple[list[Array], list[Array]]:
    """Undistorted pixels (n, 2) and their derivatives (n, 2, 6) by rotation vector and translation, per camera."""
    rotation, derivative = cv2.Rodrigues(values[:3])
    # derivative (3, 9): row k holds d R / d r_k, flattened by rows.
    pixels, slopes = [], []
    for camera, seen in zip(cameras, points, strict=True):
        by_rotation = np.einsum("kij,nj->nik", derivative.reshape(3, 3, 3), seen)
        by_pose = np.concatenate([by_rotation, np.broadcast_to(np.eye(3), (len(seen), 3, 3))], axis=2)
        world = seen @ rotation.T + values[3:]
        pixels.append(camera.project(world))
        slopes.append(np.asarray(by_points(camera.matrix, world) @ by_pose))
    return pixels, slopes


def _undistorted_noise(camera: DLT, corners: Corners) -> Array:
    """Corner covariances (n, 2, 2) carried through the removal of the distortion."""
    step = 0.5
    columns = [
        (camera.undistorted(corners.px + shift) - camera.undistorted(corners.px - shift)) / (2 * step)
        for shift in (np.array([step, 0.0]), np.array([0.0, step]))
    ]
    slope = np.stack(columns, axis=2)
    return np.asarray(slope @ corners.covariance @ slope.transpose(0, 2, 1))


def fit_rigid(points: Array, world: Array) -> tuple[Array, Array]:
    """Rotation and translation of points (n, 3) to the world in least squares (Kabsch)."""
    centre, place = points.mean(axis=0), world.mean(axis=0)
    u, _, vt = np.linalg.svd((world - place).T @ (points - centre))
    turn = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    rotation = u @ turn @ vt
    return np.asarray(rotation), np.asarray(place - rotation @ centre)
