"""Pose of a board in the camera frame from its corners, with covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from calibration.rotation_vectors import cross_matrix, left_jacobian
from calibration.vision.lens import Lens
from calibration.vision.planar_motion import DEPARTURES, NO_PLANE, PlaneOfMotion
from calibration.vision.pose_fit import UNKNOWNS, fit_covariance, fit_pose
from calibration.vision.transforms import RigidTransform
from model.arrays import Array

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

    rotation_vector: Array
    translation_m: Array
    covariance: Array
    residuals_px: Array
    projected_px: Array
    misfit: float

    @property
    def reprojection_px(self) -> float:
        """Root mean square distance between measured and projected corners."""
        return math.sqrt(float(np.vdot(self.residuals_px, self.residuals_px)) / len(self.residuals_px))

    @property
    def rigid(self) -> RigidTransform:
        """The pose as a transform."""
        return RigidTransform.from_vectors(self.rotation_vector, self.translation_m)

    def point(self, point_m: Array) -> tuple[Array, Array]:
        """A point (3,) fixed to the board, in the camera frame, with the covariance (3, 3) that the pose gives it."""
        rotation, derivative = cv2.Rodrigues(self.rotation_vector)
        # derivative (3, 9): row k holds d R / d r_k, flattened by rows.
        by_rotation = (derivative.reshape(3, 3, 3) @ point_m).T
        jacobian = np.hstack([by_rotation, np.eye(3)])
        return rotation @ point_m + self.translation_m, jacobian @ self.covariance @ jacobian.T


def refine(
    points_m: Array,
    corners_px: Array,
    lens: Lens,
    start: tuple[Array, Array],
    corner_covariance: Array | None = None,
    unexplained: float = 0.0,
    known: PlaneOfMotion | None = None,
) -> Pose | None:
    """Minimise the reprojection error from a starting pose by Levenberg-Marquardt; None if it does not converge.

    `points_m` (n, 3) in the board's frame, `corners_px` (n, 2) with covariance (n, 2, 2) [px^2], `start` a rotation
    vector and a translation, `known` a prior that weighs in like further residuals. The covariance is that of weighted
    least squares, scaled by the variance of the weighted residuals; see `residual_covariance`.
    """
    count = len(points_m)
    if corner_covariance is None:
        corner_covariance = np.broadcast_to(_USUAL_STD_PX**2 * np.eye(2), (count, 2, 2))
    points, seen, noise, matrix, distortion = (
        np.ascontiguousarray(one, np.float64)
        for one in (points_m, corners_px, corner_covariance, lens.matrix, lens.distortion)
    )
    x = np.concatenate([start[0], start[1]]).astype(np.float64)
    plane, prior_rows = (NO_PLANE, 0) if known is None else (known.arguments, DEPARTURES)
    projected, jacobian = np.empty((count, 2)), np.empty((2 * count + prior_rows, UNKNOWNS))
    cost = fit_pose(x, points, seen, noise, matrix, distortion, plane, projected, jacobian)
    if math.isnan(cost) or x[5] <= 0:
        return None
    try:
        covariance = residual_covariance(jacobian, cost, [points_m], np.array([unexplained]))
    except np.linalg.LinAlgError:
        return None
    return Pose(x[:3], x[3:], covariance, seen - projected, projected, cost)


def residual_covariance(jacobian: Array, misfit: float, pictures: Sequence[Array], unexplained: Array) -> Array:
    """Covariance (k, k) of a least-squares fit from its whitened derivatives (2 n + m, k) and its sum of squares.

    The residuals scale the covariance, steadied by a weak prior that they are what the corners say. What they show
    beyond that, and the share of the corners' own variance that is `unexplained` (pictures,), is no noise of pixels but
    a fault of model, lens or print: it goes smoothly over the board, so that its corners do not average it out. The
    points (n, 3) that each of the `pictures` shows have rows; rows beyond theirs are of what was known beforehand.

    Raises:
        LinAlgError: the derivatives do not determine every unknown.
    """
    rows, unknowns = jacobian.shape
    scale = (misfit + _PRIOR_WEIGHT) / (rows - unknowns + _PRIOR_WEIGHT)
    covariance = np.empty((unknowns, unknowns))
    counts = np.array([len(points) for points in pictures])
    together = np.concatenate([_stacked(points.shape, points.tobytes()) for points in pictures])
    if not fit_covariance(jacobian, scale, counts, together, unexplained, covariance):
        raise np.linalg.LinAlgError("singular normal equations")
    return covariance


@lru_cache(maxsize=8)
def _stacked(shape: tuple[int, int], points: bytes) -> Array:
    """Correlation (n n,) of errors at points (n, 3) of a board by their distance, row by row."""
    points_m = np.frombuffer(points).reshape(shape)
    apart = np.linalg.norm(points_m[:, None] - points_m, axis=2)
    length = _SMOOTH_OVER * float(np.min(apart[apart > 0]))
    return np.asarray(np.exp(-0.5 * (apart / length) ** 2).ravel())


def solutions(
    points_m: Array,
    corners_px: Array,
    lens: Lens,
    corner_covariance: Array | None = None,
    unexplained: float = 0.0,
    known: PlaneOfMotion | None = None,
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


_UNIT = np.eye(3)


def tip_in_base(
    pose: Pose, board_in_tip: RigidTransform, camera_in_base: RigidTransform
) -> tuple[RigidTransform, Array]:
    """Tip in the rod-base frame with the covariance (6, 6) of its position [m] and of a small rotation [rad].

    The errors of the transforms board in tip, board in camera and camera in base are independent, so their covariances
    add. Rotations are about the axes of the rod base.
    """
    tip_in_camera = pose.rigid @ board_in_tip.inverse()
    lever_m = tip_in_camera.translation_m - pose.translation_m
    turn = left_jacobian(pose.rotation_vector)
    by_pose = np.zeros((6, 6))
    by_pose[:3, :3], by_pose[:3, 3:], by_pose[3:, :3] = -cross_matrix(lever_m) @ turn, _UNIT, turn
    covariance = by_pose @ pose.covariance @ by_pose.T + board_in_tip.error_covariance(lever_m)
    return camera_in_base.transport_pose(tip_in_camera, covariance)
