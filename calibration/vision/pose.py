"""Pose of a board in the camera frame from its corners, with covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.vision.lens import Lens
from calibration.vision.transforms import RigidTransform

Floats = NDArray[np.float64]

_ITERATIONS = 60
_CONVERGED = 1e-8
# Default corner noise.
_USUAL_STD_PX = 0.05
# Prior weight of the stated corner noise against the residuals, in observations.
_PRIOR_WEIGHT = 12.0
# Correlation length of errors of model, lens and print, in squares.
_SMOOTH_OVER = 1.0


@dataclass(frozen=True)
class Pose:
    """A board in the camera frame: rotation vector (3,) and translation (3,) [m].

    `covariance` (6, 6) is that of both, in this order; `residuals_px` (n, 2) are measured minus projected corners,
    `projected_px` (n, 2) the latter; `misfit` is the sum of squares of the residuals in units of the corners'
    standard uncertainty.
    """

    rotation_vector: Floats
    translation_m: Floats
    covariance: Floats
    residuals_px: Floats
    projected_px: Floats
    misfit: float

    @property
    def reprojection_px(self) -> float:
        """Root mean square distance between measured and projected corners."""
        return math.sqrt(float(np.vdot(self.residuals_px, self.residuals_px)) / len(self.residuals_px))

    @property
    def rigid(self) -> RigidTransform:
        """The pose as a transform."""
        return RigidTransform.from_vectors(self.rotation_vector, self.translation_m)

    def point(self, point_m: Floats) -> tuple[Floats, Floats]:
        """A point (3,) fixed to the board, in the camera frame, with the covariance (3, 3) that the pose gives it."""
        rotation, derivative = cv2.Rodrigues(self.rotation_vector)
        # derivative (3, 9): row k holds d R / d r_k, flattened by rows.
        by_rotation = (derivative.reshape(3, 3, 3) @ point_m).T
        jacobian = np.hstack([by_rotation, np.eye(3)])
        return rotation @ point_m + self.translation_m, jacobian @ self.covariance @ jacobian.T


class PosePrior(Protocol):
    """Prior on a pose."""

    def departure(self, rotation_vector: Floats, translation_m: Floats) -> tuple[Floats, Floats]:
        """Residuals (m,) of a pose from the prior, in standard uncertainties, and their derivatives (m, 6)."""


def refine(
    points_m: Floats,
    corners_px: Floats,
    lens: Lens,
    start: tuple[Floats, Floats],
    corner_covariance: Floats | None = None,
    unexplained: float = 0.0,
    known: PosePrior | None = None,
) -> Pose | None:
    """Minimise the reprojection error from a starting pose by Levenberg-Marquardt; None if it does not converge.

    `points_m` (n, 3) in the board's frame, `corners_px` (n, 2) with covariance (n, 2, 2) [px^2], `start` a rotation
    vector and a translation, `known` what weighs in like further residuals. The covariance is that of weighted least
    squares, scaled by the variance of the weighted residuals; see `residual_covariance`.
    """
    count = len(points_m)
    if corner_covariance is None:
        corner_covariance = np.broadcast_to(_USUAL_STD_PX**2 * np.eye(2), (count, 2, 2))
    # Rows of the whitener turn a residual into two of unit variance.
    whitener = np.linalg.inv(np.linalg.cholesky(corner_covariance))

    def whitened(at: Floats) -> tuple[Floats, Floats, Floats]:
        projected, jacobian = lens.project_with_jacobian(points_m, at[:3], at[3:])
        residual = np.matmul(whitener, (corners_px - projected)[:, :, None]).ravel()
        white = np.matmul(whitener, jacobian.reshape(count, 2, 6)).reshape(-1, 6)
        if known is not None:
            off, slope = known.departure(at[:3], at[3:])
            residual, white = np.concatenate([residual, -off]), np.concatenate([white, slope])
        return projected, white, residual

    x = np.concatenate([start[0], start[1]]).astype(np.float64)
    projected, jacobian, residual = whitened(x)
    cost = float(residual @ residual)
    damping = 1e-6
    for _ in range(_ITERATIONS):
        normal = jacobian.T @ jacobian
        try:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual)
        except np.linalg.LinAlgError:
            return None
        trial = x + step
        projected_new, jacobian_new, residual_new = whitened(trial)
        cost_new = float(residual_new @ residual_new)
        if not np.isfinite(cost_new):
            return None
        if cost_new <= cost:
            done = cost - cost_new <= _CONVERGED * cost
            x, projected, jacobian, residual, cost = trial, projected_new, jacobian_new, residual_new, cost_new
            damping = max(damping * 0.1, 1e-9)
        else:
            done = cost_new - cost <= _CONVERGED * cost
            damping *= 10.0
        if done:
            break
    else:
        return None
    if x[5] <= 0:
        return None
    covariance = residual_covariance(jacobian, cost, [points_m], [unexplained])
    return Pose(x[:3], x[3:], covariance, corners_px - projected, projected, cost)


def residual_covariance(
    jacobian: Floats, misfit: float, pictures: Sequence[Floats], unexplained: Sequence[float]
) -> Floats:
    """Covariance (k, k) of a least-squares fit from its whitened derivatives (2 n + m, k) and its sum of squares.

    The residuals scale the covariance, steadied by a weak prior that they are what the corners say. What they show
    beyond that, and the share of the corners' own variance that is `unexplained`, is no noise of pixels but a fault
    of model, lens or print: it goes smoothly over the board, so that its corners do not average it out. `pictures`
    has the board's points (n, 3) once for every picture; rows beyond theirs are of what was known beforehand.
    """
    unknowns = jacobian.shape[1]
    inverse = np.asarray(np.linalg.inv(jacobian.T @ jacobian))
    scale = (misfit + _PRIOR_WEIGHT) / (len(jacobian) - unknowns + _PRIOR_WEIGHT)
    gain_of_all = inverse @ jacobian.T
    seen = 2 * sum(len(points) for points in pictures)
    from_pictures, from_known = gain_of_all[:, :seen], gain_of_all[:, seen:]
    covariance = from_pictures @ from_pictures.T * scale + from_known @ from_known.T
    gains = np.split(from_pictures, len(pictures), axis=1)
    for points, gain, share in zip(pictures, gains, unexplained, strict=True):
        together = _stacked(points.shape, points.tobytes())
        # With residuals below the stated noise the unexplained part does not affect the corners.
        believed = max(share - max(1 - scale, 0.0), 0.0)
        shared = max(scale - 1, 0.0) * together + believed * scale * (together - np.eye(len(points)))
        for axis in (gain[:, 0::2], gain[:, 1::2]):
            covariance = covariance + axis @ shared @ axis.T
    return np.asarray(covariance)


@lru_cache(maxsize=8)
def _stacked(shape: tuple[int, int], points: bytes) -> Floats:
    """Correlation (n, n) of errors at points (n, 3) of a board by their distance, equal in every picture."""
    points_m = np.frombuffer(points).reshape(shape)
    apart = np.linalg.norm(points_m[:, None] - points_m, axis=2)
    length = _SMOOTH_OVER * float(np.min(apart[apart > 0]))
    return np.asarray(np.exp(-0.5 * (apart / length) ** 2))


def solutions(
    points_m: Floats,
    corners_px: Floats,
    lens: Lens,
    corner_covariance: Floats | None = None,
    unexplained: float = 0.0,
    known: PosePrior | None = None,
) -> tuple[Pose, ...]:
    """Return the one or two refined poses of a planar board (flip ambiguity), best first.

    A plane seen from afar looks nearly the same tilted either way (the flip); IPPE gives both.
    """
    found, rotations, translations, _ = cv2.solvePnPGeneric(
        points_m, corners_px, lens.matrix, lens.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    if not found:
        return ()
    starts = np.concatenate([np.array(rotations), np.array(translations)], axis=1, dtype=np.float64)
    poses = [
        refine(points_m, corners_px, lens, (start[:3, 0], start[3:, 0]), corner_covariance, unexplained, known)
        for start in starts
    ]
    return tuple(sorted((p for p in poses if p is not None), key=lambda p: p.misfit))
