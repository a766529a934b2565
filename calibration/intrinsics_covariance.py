"""Covariance of a camera's intrinsics from the residuals of its views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from model.arrays import Array


def intrinsics_covariance(slopes: Sequence[tuple[Array, Array]], residuals: Sequence[Array]) -> Array:
    """Covariance (p, p) of intrinsics that are common to all views, with the pose of each view free.

    slopes: of each view, the derivatives of its n corner coordinates by its pose (n, 6) and by the intrinsics (n, p);
    residuals: (n,) of each view, at the least-squares solution.

    Corners of one view share errors: a bent board, blur by motion, the light. So each view counts as one observation
    (jackknife over views; MacKinnon and White 1985, HC3, with views as clusters). Where that is smaller than the
    covariance for independent corners, as it can be by chance with few views, the latter is returned.
    """
    own = [_without_pose(pose, intrinsics) for pose, intrinsics in slopes]
    parts = [slope.T @ slope for slope in own]
    normal = np.sum(parts, axis=0)
    views, p = len(own), len(normal)
    squares = sum(float(residual @ residual) for residual in residuals)
    count = sum(residual.size for residual in residuals)
    pose_unknowns = sum(pose.shape[1] for pose, _ in slopes)
    independent = squares / max(count - p - pose_unknowns, 1) * np.linalg.pinv(normal, hermitian=True)
    shifts = np.array(
        [
            np.linalg.pinv(normal - part, hermitian=True) @ (slope.T @ residual)
            for part, slope, residual in zip(parts, own, residuals, strict=True)
        ]
    )
    shifts -= shifts.mean(axis=0)
    by_view = (views - 1) / views * shifts.T @ shifts
    larger = by_view if np.trace(normal @ by_view) > np.trace(normal @ independent) else independent
    return np.asarray((larger + larger.T) / 2)


def _without_pose(pose: Array, intrinsics: Array) -> Array:
    """The part (n, p) of the derivatives by the intrinsics that no change of the pose can replace."""
    return np.asarray(intrinsics - pose @ np.linalg.lstsq(pose, intrinsics, rcond=None)[0])
