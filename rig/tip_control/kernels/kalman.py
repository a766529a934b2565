"""Steps of a Kalman filter with a measurement of three coordinates."""

from __future__ import annotations

import numpy as np

from model.arrays import Array
from rig.tip_control.kernels.compilation import compiled, internal


@internal
def inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix (3, 3), by cofactors."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    found = np.empty((3, 3))
    found[0, 0], found[0, 1], found[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    found[1, 1], found[1, 2], found[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * found[0, 0] + b * found[0, 1] + c * found[0, 2]
    for row in range(3):
        for column in range(row, 3):
            found[row, column] /= determinant
            found[column, row] = found[row, column]
    return found


@internal
def projected(covariance: Array, jacobian: Array) -> Array:
    """Jacobian times covariance (3, n)."""
    size = covariance.shape[0]
    found = np.zeros((3, size))
    for row in range(3):
        for k in range(size):
            slope = jacobian[row, k]
            if slope != 0.0:
                for j in range(size):
                    found[row, j] += slope * covariance[k, j]
    return found


@internal
def expected(against: Array, jacobian: Array, noise: Array) -> Array:
    """Covariance (3, 3) of the innovation, from Jacobian times covariance `against` (3, n)."""
    found = noise.copy()
    for row in range(3):
        for column in range(3):
            for k in range(against.shape[1]):
                found[row, column] += against[row, k] * jacobian[column, k]
    return found


@compiled
def innovation(covariance: Array, jacobian: Array, noise: Array, gap: Array) -> tuple[Array, float]:
    """Expected covariance (3, 3) of an innovation `gap` (3,), and its normalised innovation squared (NIS)."""
    found = expected(projected(covariance, jacobian), jacobian, noise)
    weight, nis = inverse(found), 0.0
    for row in range(3):
        for column in range(3):
            nis += gap[row] * weight[row, column] * gap[column]
    return found, nis


@compiled
def joseph_update(
    z: Array, covariance: Array, jacobian: Array, noise: Array, gap: Array, moves: Array
) -> tuple[Array, Array]:
    """Estimates (n,) and their covariance (n, n) after one measurement.

    `gap` (3,) is the innovation. `moves` (n,) multiplies the rows of the gain: 0 for estimates that stay. The
    covariance is updated in Joseph form, which holds for every gain.
    """
    size = len(z)
    against = projected(covariance, jacobian)
    weight = inverse(expected(against, jacobian, noise))
    gain = np.zeros((size, 3))
    after, reduced = z.copy(), covariance.copy()
    for k in range(size):
        for column in range(3):
            for row in range(3):
                gain[k, column] += moves[k] * against[row, k] * weight[row, column]
            after[k] += gain[k, column] * gap[column]
    # (I - K H) P, then times (I - K H)^T, plus K R K^T.
    for k in range(size):
        for row in range(3):
            for j in range(size):
                reduced[k, j] -= gain[k, row] * against[row, j]
    for k in range(size):
        for column in range(3):
            change = 0.0
            for j in range(size):
                change -= reduced[k, j] * jacobian[column, j]
            against[column, k] = change
            for row in range(3):
                against[column, k] += gain[k, row] * noise[row, column]
    for k in range(size):
        for column in range(3):
            for j in range(size):
                reduced[k, j] += against[column, k] * gain[j, column]
    return after, reduced
