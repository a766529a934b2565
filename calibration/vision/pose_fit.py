"""Compiled least squares of a board's pose: the reprojection error by Levenberg-Marquardt, and the covariance."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from calibration.vision import planar_motion, projection, small_systems
from calibration.vision.planar_motion import PlaneArguments, depart
from calibration.vision.projection import project_with_slopes
from calibration.vision.small_systems import solve
from model.arrays import Array
from model.kernels.jit import kernel

UNKNOWNS = 6
_ITERATIONS = 60
_CONVERGED = 1e-8
_FIRST_DAMPING, _LEAST_DAMPING = 1e-6, 1e-9

_sources = (__file__, planar_motion.__file__, projection.__file__, small_systems.__file__)
exact_kernel = partial(kernel, sources=_sources, fastmath=False)


@exact_kernel
def _whitener(covariance: Array, whitener: Array) -> bool:
    """Fill lower triangles (n, 2, 2) that turn errors of these covariances into two of unit variance."""
    for i in range(len(covariance)):
        xx, xy, yy = covariance[i, 0, 0], covariance[i, 1, 0], covariance[i, 1, 1]
        rest = yy - xy * xy / xx
        if not (xx > 0.0 and rest > 0.0):
            return False
        a, b = 1.0 / np.sqrt(xx), 1.0 / np.sqrt(rest)
        whitener[i, 0, 0], whitener[i, 0, 1] = a, 0.0
        whitener[i, 1, 0], whitener[i, 1, 1] = -xy / xx * b, b
    return True


@exact_kernel
def _at(
    x: Array,
    points: Array,
    corners: Array,
    whitener: Array,
    matrix: Array,
    distortion: Array,
    plane: PlaneArguments,
    projected: Array,
    residual: Array,
    jacobian: Array,
) -> float:
    """Fill pixels (n, 2), weighted residuals (2 n + m,) and derivatives (2 n + m, 6) at a pose; the cost."""
    n = len(points)
    slopes = jacobian[: 2 * n].reshape(n, 2, UNKNOWNS)
    project_with_slopes(points, x[:3], x[3:], matrix, distortion, projected, slopes)
    for i in range(n):
        u, v = corners[i, 0] - projected[i, 0], corners[i, 1] - projected[i, 1]
        residual[2 * i] = whitener[i, 0, 0] * u
        residual[2 * i + 1] = whitener[i, 1, 0] * u + whitener[i, 1, 1] * v
        for k in range(UNKNOWNS):
            by_u, by_v = slopes[i, 0, k], slopes[i, 1, k]
            slopes[i, 0, k] = whitener[i, 0, 0] * by_u
            slopes[i, 1, k] = whitener[i, 1, 0] * by_u + whitener[i, 1, 1] * by_v
    if len(residual) > 2 * n:
        depart(plane, x[:3], x[3:], residual[2 * n :], jacobian[2 * n :])
        for k in range(2 * n, len(residual)):
            residual[k] = -residual[k]
    cost = 0.0
    for k in range(len(residual)):
        cost += residual[k] * residual[k]
    return cost


@exact_kernel
def _normal_equations(jacobian: Array, residual: Array, normal: Array, right: Array) -> None:
    """Fill J^T J (6, 6) and J^T r (6,)."""
    for i in range(UNKNOWNS):
        right[i] = 0.0
        for j in range(i + 1):
            normal[i, j] = 0.0
    for row in range(len(residual)):
        for i in range(UNKNOWNS):
            right[i] += jacobian[row, i] * residual[row]
            for j in range(i + 1):
                normal[i, j] += jacobian[row, i] * jacobian[row, j]
    for i in range(UNKNOWNS):
        for j in range(i):
            normal[j, i] = normal[i, j]


@exact_kernel
def fit_pose(
    x: Array,
    points: Array,
    corners: Array,
    covariance: Array,
    matrix: Array,
    distortion: Array,
    plane: PlaneArguments,
    projected: Array,
    jacobian: Array,
) -> float:
    """Move the pose `x` (6,) to the least cost, and return that; NaN without convergence.

    `corners` (n, 2) with `covariance` (n, 2, 2) are where `points` (n, 3) are seen. `projected` (n, 2) and the weighted
    derivatives `jacobian` (2 n + m, 6) are filled; with m = 3 rows more than the corners have, `plane` is a prior.
    """
    rows = jacobian.shape[0]
    whitener = np.empty_like(covariance)
    residual, normal, step = np.empty(rows), np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    trial, projected_new, jacobian_new = np.empty(UNKNOWNS), np.empty_like(projected), np.empty_like(jacobian)
    residual_new = np.empty(rows)
    if not _whitener(covariance, whitener):
        return np.nan
    cost = _at(x, points, corners, whitener, matrix, distortion, plane, projected, residual, jacobian)
    damping = _FIRST_DAMPING
    for _ in range(_ITERATIONS):
        _normal_equations(jacobian, residual, normal, step)
        for k in range(UNKNOWNS):
            normal[k, k] *= 1.0 + damping
        if not solve(normal, step):
            return np.nan
        for k in range(UNKNOWNS):
            trial[k] = x[k] + step[k]
        cost_new = _at(
            trial, points, corners, whitener, matrix, distortion, plane, projected_new, residual_new, jacobian_new
        )
        if not np.isfinite(cost_new):
            return np.nan
        done = abs(cost - cost_new) <= _CONVERGED * cost
        if cost_new <= cost:
            x[:], projected[:], jacobian[:], residual[:] = trial, projected_new, jacobian_new, residual_new
            cost = cost_new
            damping = max(damping * 0.1, _LEAST_DAMPING)
        else:
            damping *= 10.0
        if done:
            return float(cost)
    return np.nan


@exact_kernel
def add_smooth_errors(covariance: Array, gain: Array, together: Array, by_all: float, by_own: float) -> None:
    """Add to a covariance (k, k) what errors of the pixels u and v of covariance (n, n) give by `gain` (k, 2 n).

    That covariance is (by_all + by_own) `together` - by_own I.
    """
    n, unknowns = len(together), len(gain)
    shared = np.empty((unknowns, n))
    for axis in range(2):
        for k in range(unknowns):
            for j in range(n):
                total = 0.0
                for i in range(n):
                    total += gain[k, 2 * i + axis] * together[i, j]
                shared[k, j] = (by_all + by_own) * total - by_own * gain[k, 2 * j + axis]
        for k in range(unknowns):
            for m in range(unknowns):
                for j in range(n):
                    covariance[k, m] += shared[k, j] * gain[m, 2 * j + axis]


@exact_kernel
def fit_covariance(
    jacobian: Array,
    scale: float,
    counts: NDArray[np.int64],
    together: Array,
    unexplained: Array,
    covariance: Array,
) -> bool:
    """Fill the covariance (k, k) of a fit; see `residual_covariance` of the poses. False where it has none.

    Of every picture `counts` says how many points n it shows, `unexplained` the share of smooth errors; `together` has
    their correlation (n, n), one picture after the other in one row.
    """
    rows, unknowns = jacobian.shape
    inverse, unused = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    for row in range(rows):
        for i in range(unknowns):
            for j in range(unknowns):
                inverse[i, j] += jacobian[row, i] * jacobian[row, j]
    if not solve(inverse, unused):
        return False
    gain = np.empty((unknowns, rows))
    for i in range(unknowns):
        for row in range(rows):
            total = 0.0
            for j in range(unknowns):
                total += inverse[i, j] * jacobian[row, j]
            gain[i, row] = total
    seen = 0
    for count in counts:  # counts.sum() would load numba's compiler and SciPy
        seen += 2 * count
    for i in range(unknowns):
        for j in range(unknowns):
            from_pictures = from_known = 0.0
            for row in range(seen):
                from_pictures += gain[i, row] * gain[j, row]
            for row in range(seen, rows):
                from_known += gain[i, row] * gain[j, row]
            covariance[i, j] = from_pictures * scale + from_known
    first, first_of_square = 0, 0
    for picture in range(len(counts)):
        n = counts[picture]
        # With residuals below the stated noise the unexplained part does not affect the corners.
        believed = max(unexplained[picture] - max(1.0 - scale, 0.0), 0.0)
        by_all, by_own = max(scale - 1.0, 0.0), believed * scale
        if by_all > 0.0 or by_own > 0.0:
            columns = np.ascontiguousarray(gain[:, first : first + 2 * n])
            square = together[first_of_square : first_of_square + n * n].reshape(n, n)
            add_smooth_errors(covariance, columns, square, by_all, by_own)
        first, first_of_square = first + 2 * n, first_of_square + n * n
    return True
