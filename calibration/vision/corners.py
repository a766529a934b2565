"""Corners to a few hundredths of a pixel, each with its covariance: a model of the grey values round it is fitted.

`cv2.cornerSubPix` interpolates between pixels, which costs up to 0.07 px that depend on where in its pixel a corner
lies; the model is compared at the pixels themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision.corner_model import LARGEST_RADIUS_PX, LEAST_VARIANCE, TAPER_PX, edge_shape, fit
from model.arrays import Array
from model.kernels.jit import kernel

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)
fast_kernel = partial(kernel, sources=(__file__,), fastmath=True)

# The window is kept clear of the neighbouring edges: its radius as a share of their distance, bounds in px.
RADIUS_SHARE = 0.46
RADIUS_BOUNDS_PX = (2.2, LARGEST_RADIUS_PX)
# Knots of the edges' own shape lie so many blurs apart, but not less than so many px.
KNOT_BLURS = 0.25
LEAST_KNOT_PX = 0.2
_COARSE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.02)
START_BLUR_PX = 0.8
# What the corners before say of the blur, against what this corner's pixels say: its squared share of the step.
BLUR_OPINION = 0.05
# The same once it is estimated from all corners: they share a lens, and the motion.
BLUR_CERTAIN = 1.0
# The middle of a square that no edge's blur reaches: half its width as a share of the edges' distance.
_MIDDLE_SHARE = 0.15
# Of the grey values' variance beyond their noise: what the estimate of the noise may miss by chance, and how much of
# the rest moves corners (most of a wrong edge profile is symmetric and does not).
TOLD_BY_CHANCE = 0.25
MOVES_CORNERS = 0.5
# Where windows overlap neighbours share pixels, and with them errors.
_BY_OVERLAP = 0.8
# A corner whose pixels scatter so many times more than the median corner's is judged by itself.
_ITS_OWN = 2.5
# Largest relative change of the light within the radius of a window.
_STEEPEST = 0.5
# Residual error of a picture without noise: a pixel is a box, and the model has only a Gaussian.
_SYSTEMATIC_PX = 0.003


@dataclass(frozen=True)
class Corners:
    """Corners `px` (n, 2) with covariance (n, 2, 2) [px^2].

    `seen` (n,) says which of the board's corners they are; None: all of them, in order.

    `contrast` (n,) is the step from dark to bright in grey levels, positive where the quadrant between the two edge
    directions (along a row, down a column) is bright; `misfit` (n,) the rms of what the model leaves, in shares of
    the step. `unexplained` is the share of the variance that is not noise of pixels but the model's own fault.
    `carried_px` (n, 2) is the standard uncertainty that all corners share, as they do when carried to another time.
    """

    px: Array
    covariance: Array
    contrast: Array
    misfit: Array
    unexplained: float = 0.0
    carried_px: Array | None = None
    seen: NDArray[np.intp] | None = None

    @property
    def index(self) -> NDArray[np.intp]:
        """Which of the board's corners they are (n,)."""
        return np.arange(len(self.px)) if self.seen is None else self.seen

    def of(self, points: Array) -> Array:
        """Of the board's points (m, 3) those of the corners (n, 3)."""
        return points if self.seen is None else points[self.seen]

    def keeping(self, kept: NDArray[np.bool_]) -> Corners:
        """Some of the corners; `kept` (n,) says which."""
        return replace(
            self,
            px=self.px[kept],
            covariance=self.covariance[kept],
            contrast=self.contrast[kept],
            misfit=self.misfit[kept],
            carried_px=None if self.carried_px is None else self.carried_px[kept],
            seen=self.index[kept],
        )

    def padded(self, count: int) -> Array:
        """All `count` corners of the board (count, 2) [px], NaN where one is not seen."""
        if self.seen is None:
            return self.px
        every = np.full((count, 2), np.nan)
        every[self.seen] = self.px
        return every


def spacing(corners_px: Array, pattern: tuple[int, int]) -> float:
    """Smallest distance [px] between neighbours in corners (n, 2) of a pattern (columns, rows)."""
    grid = corners_px.reshape(pattern[1], pattern[0], 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2).min()
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2).min()
    return float(min(across, down))


@exact_kernel
def _room(grid: Array) -> float:
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


def refine_corners(image: Image, seeds_px: Array, pattern: tuple[int, int]) -> Corners | None:
    """Refine corners (n, 2), known to a few pixels, of a pattern (columns, rows) in a grey picture.

    None where a corner has no model: too near the border, or its surroundings are not those of a corner.
    """
    grid = (pattern[1], pattern[0], 2)
    smallest, largest = RADIUS_BOUNDS_PX
    room = _room(seeds_px.reshape(grid))
    radius = min(max(RADIUS_SHARE * room, smallest), largest)
    kept, coarse = coarse_corners(image, seeds_px, math.floor(radius))
    if len(kept) < len(seeds_px):
        return None
    # The first look moved the corners, so the directions are taken from where they are now.
    normals = _edge_normals(coarse.reshape(grid))
    usual = np.full(2, START_BLUR_PX)
    nothing = np.zeros((2, 1))
    first = fit(image, coarse, normals, radius, np.zeros_like(coarse), nothing, 1.0, usual, BLUR_OPINION, False)
    if not _plausible(first.px, seeds_px, radius):
        return None
    # No lens blurs like a Gaussian: the common edge shape is estimated from all corners, then used in the fit.
    blur = column_medians(first.blur)
    knot = max(KNOT_BLURS * float(blur.mean()), LEAST_KNOT_PX)
    normals = _edge_normals(first.px.reshape(grid))
    light = light_gradient(first.px, first.levels, radius)
    shape = edge_shape(image, first.px, normals, radius, light, first.levels, blur, knot)
    found = fit(image, first.px, normals, radius, light, shape, knot, blur, BLUR_CERTAIN, False)
    if not _plausible(found.px, seeds_px, radius):
        return None
    pooled, total = uncertainty(found.variance, found.spread)
    beyond_noise = 1 - _pixel_noise(image, found.px.reshape(grid)) / pooled
    unexplained = MOVES_CORNERS * max(0.0, beyond_noise - TOLD_BY_CHANCE)
    overlap = max(0.0, 2 * (radius + TAPER_PX / 2) / room - 1)
    unexplained = min(max(unexplained, _BY_OVERLAP * overlap), 1.0)
    return Corners(found.px, total, found.contrast, found.misfit, unexplained)


def _plausible(px: Array, seeds_px: Array, radius: float) -> bool:
    return bool(np.isfinite(px).all() and np.abs(px - seeds_px).max() <= radius + 1)


@exact_kernel
def median(values: Array) -> float:
    """Median of finite numbers (n,) by insertion sort.

    With NumPy's function a kernel on the disk needs numba's compiler and SciPy to be loaded.
    """
    n = len(values)
    ordered = np.empty(n)
    for i in range(n):
        value, j = values[i], i
        while j > 0 and ordered[j - 1] > value:
            ordered[j] = ordered[j - 1]
            j -= 1
        ordered[j] = value
    return float(0.5 * (ordered[(n - 1) // 2] + ordered[n // 2]))


@exact_kernel
def column_medians(values: Array) -> Array:
    """Median of each column of (n, k)."""
    middle = np.empty(values.shape[1])
    for k in range(values.shape[1]):
        middle[k] = median(values[:, k])
    return middle


@exact_kernel
def uncertainty(variance: Array, spread: Array) -> tuple[float, Array]:
    """The grey values' variance about the fits, and the corners' covariance (n, 2, 2).

    The noise is pooled over the board, because one corner has too few pixels to estimate it; a corner with much larger
    residuals, as in glare or shadow, keeps its own variance.
    """
    pooled = median(variance)
    total = np.empty_like(spread)
    for c in range(len(variance)):
        noise = variance[c] if variance[c] > _ITS_OWN * pooled else pooled
        for i in range(2):
            for j in range(2):
                total[c, i, j] = noise * spread[c, i, j] + (_SYSTEMATIC_PX**2 if i == j else 0.0)
    return pooled, total


@exact_kernel
def _pixel_noise(image: Image, grid: Array) -> float:
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
    return max(total / (2 * count), LEAST_VARIANCE)


@exact_kernel
def light_gradient(px: Array, levels: Array, radius: float) -> Array:
    """Relative gradient of the light (n, 2) [1/px] at corners (n, 2): a plane through their mean levels (n,).

    Least squares over the whole board: the levels of single corners scatter too much where squares are small.
    """
    count = len(px)
    x0 = y0 = mean = 0.0
    for c in range(count):
        x0, y0, mean = x0 + px[c, 0] / count, y0 + px[c, 1] / count, mean + levels[c, 0] / count
    xx = xy = yy = by_x = by_y = 0.0
    for c in range(count):
        x, y, level = px[c, 0] - x0, px[c, 1] - y0, levels[c, 0] - mean
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
        by_x, by_y = by_x + x * level, by_y + y * level
    light = np.zeros((count, 2))
    area = xx * yy - xy * xy
    if area <= 0.0:
        return light
    gx, gy = (by_x * yy - by_y * xy) / area, (by_y * xx - by_x * xy) / area
    for c in range(count):
        level = mean + gx * (px[c, 0] - x0) + gy * (px[c, 1] - y0)
        # Within the window the light stays positive.
        level = max(level, radius * math.hypot(gx, gy) / _STEEPEST, 1.0)
        light[c, 0], light[c, 1] = gx / level, gy / level
    return light


def coarse_corners(image: Image, seeds_px: Array, half: int) -> tuple[NDArray[np.intp], Array]:
    """To a tenth of a pixel by OpenCV: the corners that it moves, but not far, and that lie off the border."""
    height, width = image.shape
    margin = half + 3
    limits = np.array([width - 1 - margin, height - 1 - margin])

    def inside(px: Array) -> NDArray[np.bool_]:
        return np.asarray(((px >= margin) & (px <= limits)).all(axis=1))

    kept = np.flatnonzero(inside(seeds_px))
    if not len(kept):
        return kept, np.empty((0, 2))
    start = seeds_px[kept].astype(np.float32).reshape(-1, 1, 2)
    coarse = cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), _COARSE)
    moved = np.abs(coarse - start).max(axis=(1, 2))
    found = np.asarray(coarse[:, 0, :], dtype=np.float64)
    # Where the iteration diverges OpenCV returns its seed, to the last bit.
    good = (moved <= half) & (moved > 0) & inside(found)
    return kept[good], found[good]


@exact_kernel
def _edge_normals(grid: Array) -> Array:
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
