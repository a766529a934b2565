"""Compiled projection of points by a pinhole with Brown-Conrady distortion, and its derivatives by the pose."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from model.arrays import Array
from model.kernels.jit import kernel

# Below this square of an angle the series of the coefficients are exact to rounding.
_SMALL = 1e-6

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)


@exact_kernel
def turned(vector: Array, rotation: Array, slope: Array) -> None:
    """Fill the rotation (3, 3) of a rotation vector (3,) (Rodrigues), and its left Jacobian `slope` (3, 3).

    A turned point q = R p then changes with the vector by d q = -[q] slope d r, [q] the cross-product matrix.
    """
    square = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
    if square < _SMALL:
        a, b, c = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        angle = math.sqrt(square)
        a, b = math.sin(angle) / angle, 2.0 * math.sin(0.5 * angle) ** 2 / square
        c = (1.0 - a) / square
    for i in range(3):
        for j in range(3):
            product = vector[i] * vector[j] - (square if i == j else 0.0)
            one = 1.0 if i == j else 0.0
            rotation[i, j], slope[i, j] = one + b * product, one + c * product
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        rotation[k, j] += a * vector[i]
        rotation[j, k] -= a * vector[i]
        slope[k, j] += b * vector[i]
        slope[j, k] -= b * vector[i]


@exact_kernel
def slope_by_turn(by_point: Array, point: Array, slope: Array, out: Array) -> None:
    """Fill `out` (3,): what changes with a turned point by `by_point` (3,) changes so with the rotation vector."""
    lever_x = point[1] * by_point[2] - point[2] * by_point[1]
    lever_y = point[2] * by_point[0] - point[0] * by_point[2]
    lever_z = point[0] * by_point[1] - point[1] * by_point[0]
    for k in range(3):
        out[k] = lever_x * slope[0, k] + lever_y * slope[1, k] + lever_z * slope[2, k]


@exact_kernel
def pixel(x: float, y: float, matrix: Array, distortion: Array) -> tuple[float, float]:
    """The pixel of an undistorted ray (x, y, 1) by `matrix` and `distortion` as those of `Lens`."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = matrix[0, 0] * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + matrix[0, 2]
    v = matrix[1, 1] * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + matrix[1, 2]
    return u, v


@exact_kernel
def project(points: Array, vector: Array, translation: Array, matrix: Array, distortion: Array, pixels: Array) -> None:
    """Fill the pixels (n, 2) of points (n, 3) whose frame stands at a pose before the camera."""
    rotation, slope = np.empty((3, 3)), np.empty((3, 3))
    turned(vector, rotation, slope)
    for i in range(len(points)):
        px, py, pz = points[i]
        depth = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + translation[2]
        x = (rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + translation[0]) / depth
        y = (rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + translation[1]) / depth
        pixels[i, 0], pixels[i, 1] = pixel(x, y, matrix, distortion)


@exact_kernel
def project_with_slopes(
    points: Array,
    vector: Array,
    translation: Array,
    matrix: Array,
    distortion: Array,
    pixels: Array,
    slopes: Array,
) -> None:
    """As `project`; fill also the derivatives (n, 2, 6) of the pixels by rotation vector and translation."""
    k1, k2, p1, p2, k3 = distortion
    rotation, slope = np.empty((3, 3)), np.empty((3, 3))
    turned(vector, rotation, slope)
    q = np.empty(3)
    project(points, vector, translation, matrix, distortion, pixels)
    for i in range(len(points)):
        for k in range(3):
            q[k] = rotation[k, 0] * points[i, 0] + rotation[k, 1] * points[i, 1] + rotation[k, 2] * points[i, 2]
        depth = q[2] + translation[2]
        x, y = (q[0] + translation[0]) / depth, (q[1] + translation[1]) / depth
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        by_r2 = k1 + r2 * (2 * k2 + 3 * k3 * r2)
        mixed = 2 * (x * y * by_r2 + p1 * x + p2 * y)
        for row in range(2):
            focal = matrix[row, row] / depth
            if row == 0:
                by_x, by_y = focal * (radial + 2 * x * x * by_r2 + 2 * p1 * y + 6 * p2 * x), focal * mixed
            else:
                by_x, by_y = focal * mixed, focal * (radial + 2 * y * y * by_r2 + 6 * p1 * y + 2 * p2 * x)
            by_point = slopes[i, row, 3:]
            by_point[0], by_point[1], by_point[2] = by_x, by_y, -(by_x * x + by_y * y)
            slope_by_turn(by_point, q, slope, slopes[i, row, :3])


@exact_kernel
def extent(
    points: Array, rotations: Array, translations: Array, matrix: Array, distortion: Array, bounds: Array
) -> float:
    """Fill the least and the greatest pixel (2, 2) of points (n, 3) at poses (k, 3, 3), (k, 3); the least depth [m].

    `bounds` is valid where that is positive.
    """
    bounds[0, :], bounds[1, :] = np.inf, -np.inf
    nearest = np.inf
    for k in range(len(rotations)):
        rotation, place = rotations[k], translations[k]
        for i in range(len(points)):
            px, py, pz = points[i]
            depth = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + place[2]
            x = (rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + place[0]) / depth
            y = (rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + place[1]) / depth
            u, v = pixel(x, y, matrix, distortion)
            nearest = min(nearest, depth)
            bounds[0, 0], bounds[0, 1] = min(bounds[0, 0], u), min(bounds[0, 1], v)
            bounds[1, 0], bounds[1, 1] = max(bounds[1, 0], u), max(bounds[1, 1], v)
    return nearest
