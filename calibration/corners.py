"""Corners to a few hundredths of a pixel, each with its covariance: a model of the grey values round it is fitted.

`cv2.cornerSubPix` interpolates between pixels, which costs up to 0.07 px that depend on where in its pixel a corner
lies; the model is compared at the pixels themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from model.compiled import kernel

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)
fast_kernel = partial(kernel, sources=(__file__,), fastmath=True)

# The window is kept clear of the neighbouring edges: its radius as a share of their distance, bounds in px.
_RADIUS_SHARE = 0.42
_RADIUS_BOUNDS_PX = (2.2, 9.0)
_COARSE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.02)
_PARAMETERS = 6
_STEPS = 12
_STILL_PX = 0.02
_START_BLUR_PX = 0.8
_BLUR_BOUNDS_PX = (0.3, 6.0)
# What the corners before say of the blur, against what this corner's pixels say: its squared share of the step.
_BLUR_OPINION = 0.05
# The middle of a square that no edge's blur reaches: half its width as a share of the edges' distance.
_MIDDLE_SHARE = 0.15
# Of the grey values' variance beyond their noise: what the estimate of the noise may miss by chance, and how much of
# the rest moves corners (most of a wrong edge profile is symmetric and does not).
_TOLD_BY_CHANCE = 0.25
_MOVES_CORNERS = 0.5
# A corner whose pixels scatter so many times more than the median corner's is judged by itself.
_ITS_OWN = 2.5
# What is left where the picture has no noise: a pixel is a box, and the model knows only a bell.
_SYSTEMATIC_PX = 0.003
# Quantisation to whole grey levels: no picture is better than this.
_LEAST_VARIANCE = 1 / 12


@dataclass(frozen=True)
class Corners:
    """Corners `px` (n, 2) with covariance (n, 2, 2) [px^2].

    `contrast` (n,) is the step from dark to bright in grey levels, positive where the quadrant between the two edge
    directions (along a row, down a column) is bright; `misfit` (n,) the rms of what the model leaves, in shares of
    the step. `unexplained` is the share of the variance that is not noise of pixels but the model's own fault.
    """

    px: Floats
    covariance: Floats
    contrast: Floats
    misfit: Floats
    unexplained: float = 0.0


def spacing(corners_px: Floats, pattern: tuple[int, int]) -> float:
    """Smallest distance [px] between neighbours in corners (n, 2) of a pattern (columns, rows)."""
    grid = corners_px.reshape(pattern[1], pattern[0], 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2).min()
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2).min()
    return float(min(across, down))


@exact_kernel
def _room(grid: Floats) -> float:
    """Smallest distance [px] between neighbouring edges of corners (rows, columns, 2).

    That is less than between corners where squares look sheared.
    """
    least = np.inf
    for i in range(grid.shape[0] - 1):
        for j in range(grid.shape[1] - 1):
            ax, ay = grid[i, j + 1, 0] - grid[i, j, 0], grid[i, j + 1, 1] - grid[i, j, 1]
            dx, dy = grid[i + 1, j, 0] - grid[i, j, 0], grid[i + 1, j, 1] - grid[i, j, 1]
            longer = max(math.hypot(ax, ay), math.hypot(dx, dy))
            least = min(least, abs(ax * dy - ay * dx) / longer)
    return least


def sharpen(image: Image, seeds_px: Floats, pattern: tuple[int, int]) -> Corners | None:
    """Refine corners (n, 2), known to a few pixels, of a pattern (columns, rows) in a grey picture.

    None where a corner has no model: too near the border, or its surroundings are not those of a corner.
    """
    grid = (pattern[1], pattern[0], 2)
    smallest, largest = _RADIUS_BOUNDS_PX
    radius = min(max(_RADIUS_SHARE * _room(seeds_px.reshape(grid)), smallest), largest)
    coarse = _coarse(image, seeds_px, math.floor(radius))
    if coarse is None:
        return None
    # The first look moved the corners, so the directions are taken from where they are now.
    normals = _edge_normals(coarse.reshape(grid))
    fitted, spread, variance, contrast, misfit = _fit(image, coarse, normals, radius)
    if not np.isfinite(fitted).all() or np.abs(fitted - seeds_px).max() > radius + 1:
        return None
    pooled, total = _uncertainty(variance, spread)
    beyond_noise = 1 - _pixel_noise(image, fitted.reshape(grid)) / pooled
    unexplained = _MOVES_CORNERS * max(0.0, beyond_noise - _TOLD_BY_CHANCE)
    return Corners(fitted, total, contrast, misfit, unexplained)


@exact_kernel
def _uncertainty(variance: Floats, spread: Floats) -> tuple[float, Floats]:
    """The grey values' variance about the fits, and the corners' covariance (n, 2, 2).

    A few dozen pixels tell their own noise badly, all of the board's together well; but a corner in glare or shadow is
    as bad as it looks.
    """
    pooled = np.median(variance)
    total = np.empty_like(spread)
    for c in range(len(variance)):
        noise = variance[c] if variance[c] > _ITS_OWN * pooled else pooled
        for i in range(2):
            for j in range(2):
                total[c, i, j] = noise * spread[c, i, j] + (_SYSTEMATIC_PX**2 if i == j else 0.0)
    return pooled, total


@exact_kernel
def _pixel_noise(image: Image, grid: Floats) -> float:
    """Variance of the grey values where nothing is to be seen: between neighbours in the middle of the squares.

    `grid` are the corners (rows, columns, 2). Infinite, that is unknown, where the squares are too small to have a
    middle.
    """
    half = int(_MIDDLE_SHARE * _room(grid))
    if half < 1:
        return np.inf
    total, count = 0.0, 0
    for i in range(grid.shape[0] - 1):
        for j in range(grid.shape[1] - 1):
            x0 = round((grid[i, j, 0] + grid[i, j + 1, 0] + grid[i + 1, j, 0] + grid[i + 1, j + 1, 0]) / 4)
            y0 = round((grid[i, j, 1] + grid[i, j + 1, 1] + grid[i + 1, j, 1] + grid[i + 1, j + 1, 1]) / 4)
            for y in range(y0 - half, y0 + half + 1):
                for x in range(x0 - half, x0 + half + 1):
                    if x < x0 + half:
                        total += (float(image[y, x + 1]) - float(image[y, x])) ** 2
                        count += 1
                    if y < y0 + half:
                        total += (float(image[y + 1, x]) - float(image[y, x])) ** 2
                        count += 1
    return max(total / (2 * count), _LEAST_VARIANCE)


def _coarse(image: Image, seeds_px: Floats, half: int) -> Floats | None:
    """To a tenth of a pixel by OpenCV; None where one ran away, stood still or lies too near the border."""
    height, width = image.shape
    margin = half + 3
    if seeds_px.min() < margin or np.any(seeds_px.max(axis=0) > (width - 1 - margin, height - 1 - margin)):
        return None
    start = seeds_px.astype(np.float32).reshape(-1, 1, 2)
    coarse = cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), _COARSE)
    moved = np.abs(coarse - start).max(axis=(1, 2))
    # Where the iteration diverges OpenCV hands back its seed, to the last bit.
    if moved.max() > half or moved.min() == 0.0:
        return None
    found = np.asarray(coarse[:, 0, :], dtype=np.float64)
    if found.min() < margin or np.any(found.max(axis=0) > (width - 1 - margin, height - 1 - margin)):
        return None
    return found


@exact_kernel
def _edge_normals(grid: Floats) -> Floats:
    """Unit normals (n, 2, 2) of the two edges through each corner (rows, columns, 2): along the column, along the row.

    Their signs are such that the first points on along the row and the second on down the column.
    """
    rows, columns = grid.shape[:2]
    normals = np.empty((rows * columns, 2, 2))
    for i in range(rows):
        for j in range(columns):
            left, right, up, down = max(j - 1, 0), min(j + 1, columns - 1), max(i - 1, 0), min(i + 1, rows - 1)
            # Only directions count: a step over two squares serves as well as one over one.
            ax, ay = grid[i, right, 0] - grid[i, left, 0], grid[i, right, 1] - grid[i, left, 1]
            dx, dy = grid[down, j, 0] - grid[up, j, 0], grid[down, j, 1] - grid[up, j, 1]
            side = 1.0 if ay * dx - ax * dy > 0 else -1.0
            c = i * columns + j
            normals[c, 0, 0], normals[c, 0, 1] = -side * dy / math.hypot(dx, dy), side * dx / math.hypot(dx, dy)
            normals[c, 1, 0], normals[c, 1, 1] = side * ay / math.hypot(ax, ay), -side * ax / math.hypot(ax, ay)
    return normals


@fast_kernel
def _step_edge(distance: float, blur: float) -> tuple[float, float]:
    """A blurred step from -1 to 1 and its slope: erf by Abramowitz and Stegun 7.1.26, good to 1.5e-7."""
    x = distance / (blur * math.sqrt(2.0))
    decay = math.exp(-x * x)
    t = 1.0 / (1.0 + 0.3275911 * abs(x))
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    value = 1.0 - tail * decay
    return (value if x >= 0 else -value), decay * math.sqrt(2.0 / math.pi) / blur


@exact_kernel
def _solve(matrix: Floats, right: Floats) -> bool:
    """Solve a small symmetric positive system in place by Gauss-Jordan; `matrix` becomes its inverse."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > 1e-12:
            return False
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        right[k] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
                right[i] -= factor * right[k]
    return True


@exact_kernel
def _fit(image: Image, seeds: Floats, normals: Floats, radius: float) -> tuple[Floats, ...]:
    """Fit grey = mean + half step * edge_1 * edge_2 in a disc round each corner by Gauss-Newton.

    Unknowns: the corner (2), mean, half the step, and the blur across either edge (motion blurs one more than the
    other). Returns corners (n, 2), NaN where there is no fit, their covariance at unit variance of the grey values
    (n, 2, 2), that variance (n,), steps (n,) and misfits (n,).
    """
    n = seeds.shape[0]
    corners = np.full((n, 2), np.nan)
    spread = np.full((n, 2, 2), np.nan)
    variance = np.full(n, np.nan)
    contrast = np.full(n, np.nan)
    misfit = np.full(n, np.nan)
    matrix = np.empty((_PARAMETERS, _PARAMETERS))
    right = np.empty(_PARAMETERS)
    slope = np.empty(_PARAMETERS)
    reach = math.ceil(radius)
    usual_1 = usual_2 = _START_BLUR_PX
    fitted = 0
    for c in range(n):
        cx, cy = seeds[c]
        x0, y0 = round(cx), round(cy)
        n1x, n1y = normals[c, 0]
        n2x, n2y = normals[c, 1]
        blur_1, blur_2 = usual_1, usual_2
        mean, half_step = 0.0, 0.0
        for step in range(_STEPS):
            if step == 0:
                # Mean and step follow linearly from the edges of the start.
                s_v = s_e = s_ve = s_ee = 0.0
                count = 0
                for y in range(y0 - reach, y0 + reach + 1):
                    for x in range(x0 - reach, x0 + reach + 1):
                        if (x - x0) ** 2 + (y - y0) ** 2 <= radius * radius:
                            e1, _ = _step_edge(n1x * (x - cx) + n1y * (y - cy), blur_1)
                            e2, _ = _step_edge(n2x * (x - cx) + n2y * (y - cy), blur_2)
                            value = float(image[y, x])
                            s_v += value
                            s_e += e1 * e2
                            s_ve += value * e1 * e2
                            s_ee += e1 * e2 * e1 * e2
                            count += 1
                half_step = (s_ve - s_v * s_e / count) / (s_ee - s_e * s_e / count)
                mean = (s_v - half_step * s_e) / count
            matrix[:] = 0.0
            right[:] = 0.0
            squares = 0.0
            count = 0
            for y in range(y0 - reach, y0 + reach + 1):
                for x in range(x0 - reach, x0 + reach + 1):
                    if (x - x0) ** 2 + (y - y0) ** 2 > radius * radius:
                        continue
                    d1 = n1x * (x - cx) + n1y * (y - cy)
                    d2 = n2x * (x - cx) + n2y * (y - cy)
                    e1, g1 = _step_edge(d1, blur_1)
                    e2, g2 = _step_edge(d2, blur_2)
                    rest = float(image[y, x]) - mean - half_step * e1 * e2
                    slope[0] = -half_step * (g1 * n1x * e2 + e1 * g2 * n2x)
                    slope[1] = -half_step * (g1 * n1y * e2 + e1 * g2 * n2y)
                    slope[2] = 1.0
                    slope[3] = e1 * e2
                    slope[4] = -half_step * g1 * e2 * d1 / blur_1
                    slope[5] = -half_step * g2 * e1 * d2 / blur_2
                    squares += rest * rest
                    count += 1
                    for i in range(_PARAMETERS):
                        right[i] += slope[i] * rest
                        for j in range(i + 1):
                            matrix[i, j] += slope[i] * slope[j]
            for i in range(_PARAMETERS):
                for j in range(i + 1, _PARAMETERS):
                    matrix[i, j] = matrix[j, i]
            # The blur is not determined where an edge runs midway between pixels.
            opinion = _BLUR_OPINION * (half_step * half_step + 1.0)
            matrix[4, 4] += opinion
            matrix[5, 5] += opinion
            right[4] += opinion * (usual_1 - blur_1)
            right[5] += opinion * (usual_2 - blur_2)
            if not _solve(matrix, right):
                break
            cx += min(max(right[0], -1.0), 1.0)
            cy += min(max(right[1], -1.0), 1.0)
            if (cx - seeds[c, 0]) ** 2 + (cy - seeds[c, 1]) ** 2 > 4.0:
                break
            mean += right[2]
            half_step += right[3]
            blur_1 = min(max(blur_1 + min(max(right[4], -0.4), 0.4), _BLUR_BOUNDS_PX[0]), _BLUR_BOUNDS_PX[1])
            blur_2 = min(max(blur_2 + min(max(right[5], -0.4), 0.4), _BLUR_BOUNDS_PX[0]), _BLUR_BOUNDS_PX[1])
            if abs(right[0]) < _STILL_PX and abs(right[1]) < _STILL_PX:
                variance[c] = max(squares / (count - _PARAMETERS), _LEAST_VARIANCE)
                corners[c, 0], corners[c, 1] = cx, cy
                for i in range(2):
                    for j in range(2):
                        spread[c, i, j] = matrix[i, j]
                contrast[c] = 2 * half_step
                misfit[c] = math.sqrt(squares / count) / max(abs(2 * half_step), 1e-3)
                fitted += 1
                usual_1 += (blur_1 - usual_1) / fitted
                usual_2 += (blur_2 - usual_2) / fitted
                break
    return corners, spread, variance, contrast, misfit
