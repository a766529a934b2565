"""The map from a plane, such as a board's, to a picture, and what it makes of directions and lengths."""

from __future__ import annotations

import math
from functools import partial

import cv2
import numpy as np

from model.arrays import Array
from model.kernels.jit import kernel

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)


def plane_to_image(points_m: Array, px: Array) -> Array | None:
    """Homography (3, 3) of points (n, 3) of a plane to pixels (n, 2) in least squares; None if they lie in a line."""
    if len(points_m) < 4:
        return None
    found, _ = cv2.findHomography(points_m[:, :2], np.ascontiguousarray(px))
    return None if found is None else np.asarray(found, dtype=np.float64)


def mapped(homography: Array, points_m: Array) -> Array:
    """Pixels (n, 2) of points (n, 3) of the plane."""
    px = np.empty((len(points_m), 2))
    _map(homography, np.ascontiguousarray(points_m, np.float64), px)
    return px


def least_scale(homography: Array, points_m: Array) -> float:
    """Smallest pixels per metre at points (n, 3), in the direction in which the plane is foreshortened most."""
    return float(_least_scale(homography, np.ascontiguousarray(points_m, np.float64)))


def edge_normals(homography: Array, points_m: Array, toward: Array) -> Array:
    """Unit normals (n, 2, 2) of edges along the plane's y axis and along its x axis, on the side of `toward` (n, 2).

    `toward` counts to the right and down, 1 or -1.
    """
    normals = np.empty((len(points_m), 2, 2))
    _fill_normals(homography, np.ascontiguousarray(points_m, np.float64), np.ascontiguousarray(toward), normals)
    return normals


@exact_kernel
def _map(h: Array, points: Array, px: Array) -> None:
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        px[k, 0] = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        px[k, 1] = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w


@exact_kernel
def _directions(h: Array, x: float, y: float) -> tuple[float, float, float, float]:
    """Pixels per metre along the plane's x axis (2), and down against its y axis (2)."""
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
    v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
    along_u, along_v = (h[0, 0] - u * h[2, 0]) / w, (h[1, 0] - v * h[2, 0]) / w
    return along_u, along_v, -(h[0, 1] - u * h[2, 1]) / w, -(h[1, 1] - v * h[2, 1]) / w


@exact_kernel
def _least_scale(h: Array, points: Array) -> float:
    least = math.inf
    for k in range(len(points)):
        along_u, along_v, down_u, down_v = _directions(h, points[k, 0], points[k, 1])
        longer = max(math.hypot(along_u, along_v), math.hypot(down_u, down_v))
        least = min(least, abs(along_u * down_v - along_v * down_u) / longer)
    return least


@exact_kernel
def _fill_normals(h: Array, points: Array, toward: Array, normals: Array) -> None:
    for k in range(len(points)):
        along_u, along_v, down_u, down_v = _directions(h, points[k, 0], points[k, 1])
        # A normal of one direction lies on the side of the other one.
        turn = along_u * down_v - along_v * down_u
        side = 1.0 if turn > 0 else -1.0
        down, along = math.hypot(down_u, down_v), math.hypot(along_u, along_v)
        normals[k, 0, 0], normals[k, 0, 1] = toward[k, 0] * side * down_v / down, -toward[k, 0] * side * down_u / down
        normals[k, 1, 0], normals[k, 1, 1] = (
            -toward[k, 1] * side * along_v / along,
            toward[k, 1] * side * along_u / along,
        )
