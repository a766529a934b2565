"""Bundle adjustment of a DLT: coefficients of all cameras and the control points themselves, refined together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from calibration.cross_validation import PointObservations
from calibration.dlt import DLT, by_points, undistort
from model.arrays import Array

_LEAST_STD_PX = 0.02


def adjust(cameras: Sequence[PointObservations], start: Sequence[DLT], points_std_m: float) -> tuple[DLT, ...]:
    """Refine DLTs for control points that are themselves only known to `points_std_m` (each coordinate).

    The residuals of the pixels are weighed by their own scatter at the start. The covariances returned hold what the
    points' uncertainty adds.
    """
    names = sorted({name for camera in cameras for name in camera.names})
    index = {name: k for k, name in enumerate(names)}
    given = np.zeros((len(names), 3))
    for camera in cameras:
        given[[index[n] for n in camera.names]] = camera.world_m
    seen = [c.pixels if c.lens is None else undistort(c.pixels, c.lens) for c in cameras]
    rows = [np.array([index[n] for n in c.names]) for c in cameras]
    freedom = sum(2 * len(r) - 11 for r in rows)
    squares = sum(float(np.sum(dlt.residuals_px**2)) for dlt in start)
    std_px = max(float(np.sqrt(squares / max(freedom, 1))), _LEAST_STD_PX)
    coefficients = 11 * len(cameras)
    size = coefficients + 3 * len(names)

    def both(x: Array) -> tuple[Array, Array]:
        points = given + points_std_m * x[coefficients:].reshape(-1, 3)
        rest, slope = [], []
        for i, (uv, at, dlt) in enumerate(zip(seen, rows, start, strict=True)):
            now = DLT(x[11 * i : 11 * i + 11], dlt.covariance, dlt.residuals_px)
            rest.append((now.project(points[at]) - uv).ravel() / std_px)
            part = np.zeros((2 * len(at), size))
            part[:, 11 * i : 11 * i + 11] = now.by_coefficients(points[at]) / std_px
            own = by_points(now.matrix, points[at]) * points_std_m / std_px
            for k, j in enumerate(at):
                part[2 * k : 2 * k + 2, coefficients + 3 * j : coefficients + 3 * j + 3] = own[k]
            slope.append(part)
        prior = np.zeros((3 * len(names), size))
        prior[:, coefficients:] = np.eye(3 * len(names))
        return np.concatenate([*rest, x[coefficients:]]), np.concatenate([*slope, prior])

    x0 = np.concatenate([*(dlt.coefficients for dlt in start), np.zeros(3 * len(names))])
    solved = least_squares(lambda x: both(x)[0], x0, jac=lambda x: both(x)[1], x_scale="jac")
    covariance = np.linalg.pinv(solved.jac.T @ solved.jac, hermitian=True)
    points = given + points_std_m * solved.x[coefficients:].reshape(-1, 3)
    found = []
    for i, (camera, uv, at) in enumerate(zip(cameras, seen, rows, strict=True)):
        own = slice(11 * i, 11 * i + 11)
        made = DLT(solved.x[own], np.asarray(covariance[own, own]), np.zeros((0, 2)), camera.lens)
        found.append(DLT(made.coefficients, made.covariance, uv - made.project(points[at]), camera.lens))
    return tuple(found)
