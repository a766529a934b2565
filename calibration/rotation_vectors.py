"""Rotation vectors and small rotations: the matrices of the cross product and of the Jacobians of SO(3)."""

from __future__ import annotations

import math

import numpy as np

from model.arrays import Array

# Below this angle [rad] the factors of the Jacobians are their limits.
_SMALL = 1e-4


def cross_matrix(vector: Array) -> Array:
    """The matrices (.., 3, 3) of the cross product with vectors (.., 3): [a] b = a x b."""
    out = np.zeros((*vector.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -vector[..., k], vector[..., k]
    return out


def left_jacobian(rotvec: Array) -> Array:
    """How fast a rotation turns (3, 3), in the outer frame, as its rotation vector (3,) changes."""
    angle = float(np.linalg.norm(rotvec))
    cross = cross_matrix(rotvec)
    first, second = (
        (0.5, 1 / 6) if angle < _SMALL else ((1 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3)
    )
    out: Array = np.eye(3) + first * cross + second * cross @ cross
    return out


def inverse_right_jacobian(rotvec: Array) -> Array:
    """How the vectors (K, 3) of rotations change (K, 3, 3) as these are turned in their inner frame."""
    angle = np.linalg.norm(rotvec, axis=1)
    half = np.where(angle < _SMALL, 1.0, angle) / 2
    factor = np.where(angle < _SMALL, 1 / 12, (1 - half / np.tan(half)) / (2 * half) ** 2)
    cross = cross_matrix(rotvec)
    out: Array = np.eye(3) + 0.5 * cross + factor[:, None, None] * cross @ cross
    return out
