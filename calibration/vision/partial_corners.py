"""Corners of a board of which some may be hidden: those that look as they must are kept, each with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision import corners
from calibration.vision.corner_model import LEAST_VARIANCE, TAPER_PX, CornerFit, edge_shape, fit
from calibration.vision.corners import (
    BLUR_CERTAIN,
    BLUR_OPINION,
    KNOT_BLURS,
    LEAST_KNOT_PX,
    MOVES_CORNERS,
    RADIUS_BOUNDS_PX,
    START_BLUR_PX,
    TOLD_BY_CHANCE,
    Corners,
    coarse_corners,
    column_medians,
    light_gradient,
    median,
    uncertainty,
)
from calibration.vision.plane_map import edge_normals, least_scale, mapped, plane_to_image
from model.arrays import Array
from model.kernels.jit import kernel

Indices = NDArray[np.intp]

exact_kernel = partial(kernel, sources=(__file__, corners.__file__), fastmath=False)

# The window keeps so far from other edges: their blur reaches into it.
_CLEAR_OF_EDGES_PX = 1.0
# Largest residual of the corner model and least step from dark to bright, as shares of the step and of the usual step.
_MAX_MISFIT = 0.15
_LEAST_STEP = 0.35
_LEAST_STEP_GREY = 12.0
# Something else reaches into the window of a corner whose pixels scatter so many times more than the usual one's.
_FOREIGN = 2.5


@dataclass(frozen=True)
class CornerKind:
    """What corners look like.

    `toward` (n, 2) is which way along x and y (1, -1) of the board the two edges are counted, `bright` (n,) whether
    the quadrant on that side of both is bright. The corner is a saddle of four quadrants, or the one `quadrant` of
    another colour. No other edge is nearer than `clear_m`. `systematic_px` is the standard uncertainty that the model's
    own error gives a corner, and `unexplained` the least share of the variance that neighbours have in common.
    """

    toward: Array
    bright: NDArray[np.bool_]
    clear_m: float
    quadrant: bool = False
    systematic_px: float = 0.0
    unexplained: float = 0.0


def refine_seen_corners(
    image: Image, points_m: Array, seeds_px: Array, homography: Array, kind: CornerKind, plain_m: Array
) -> Corners | None:
    """Refine those of the corners `points_m` (n, 3), known to a few pixels, that are not hidden.

    `homography` maps the board to the seeds. `plain_m` (k, 3) are places of one colour, from which the noise of the
    pixels is estimated. None if no corner looks as it must.
    """
    smallest, largest = RADIUS_BOUNDS_PX
    clear_px = kind.clear_m * least_scale(homography, points_m)
    radius = min(max(clear_px - TAPER_PX / 2 - _CLEAR_OF_EDGES_PX, smallest), largest)
    kept, px = coarse_corners(image, seeds_px, math.floor(radius))
    if not len(kept):
        return None
    plain_px = mapped(homography, plain_m)
    moved = plane_to_image(points_m[kept], px) if len(kept) > 4 else homography
    if moved is None:
        return None

    def fitted(light: Array, shape: Array, knot: float, blur: Array, firmness: float) -> tuple[Indices, CornerFit]:
        normals = edge_normals(moved, points_m[kept], kind.toward[kept])
        found = fit(image, px, normals, radius, light, shape, knot, blur, firmness, kind.quadrant)
        with np.errstate(invalid="ignore"):
            near = np.abs(found.px - seeds_px[kept]).max(axis=1) <= radius + 1
        return np.flatnonzero(near & np.isfinite(found.px).all(axis=1)), found

    good, found = fitted(np.zeros_like(px), np.zeros((2, 1)), 1.0, np.full(2, START_BLUR_PX), BLUR_OPINION)
    # What is foreign must go before the corners say what light and edges have in common.
    good = _alike(found, good, kind.bright[kept])
    if not len(good):
        return None
    kept, px, levels = kept[good], found.px[good], found.levels[good]
    blur = column_medians(found.blur[good])
    knot = max(KNOT_BLURS * float(blur.mean()), LEAST_KNOT_PX)
    light, shape = light_gradient(px, levels, radius), np.zeros((2, 1))
    if not kind.quadrant:
        normals = edge_normals(moved, points_m[kept], kind.toward[kept])
        shape = edge_shape(image, px, normals, radius, light, levels, blur, knot)
    good, found = fitted(light, shape, knot, blur, BLUR_CERTAIN)
    good = _alike(found, good, kind.bright[kept])
    if not len(good):
        return None
    pooled, covariance = uncertainty(found.variance[good], found.spread[good])
    covariance = covariance + kind.systematic_px**2 * np.eye(2)
    noise = _pixel_noise(image, plain_px, max(1, round(clear_px / 3)))
    unexplained = MOVES_CORNERS * max(0.0, 1 - noise / pooled - TOLD_BY_CHANCE)
    return Corners(
        found.px[good],
        covariance,
        found.contrast[good],
        found.misfit[good],
        min(max(unexplained, kind.unexplained), 1.0),
        seen=kept[good],
    )


def _alike(found: CornerFit, good: Indices, bright: NDArray[np.bool_]) -> Indices:
    """Of the corners `good` those with the right step, as large as the usual one, and with nothing else in the window.

    `bright` (n,) is of all corners that were fitted.
    """
    if not len(good):
        return good
    step = np.where(bright[good], found.contrast[good], -found.contrast[good])
    least = max(_LEAST_STEP_GREY, _LEAST_STEP * median(step))
    good = good[(step > least) & (found.misfit[good] < _MAX_MISFIT)]
    if not len(good):
        return good
    return np.asarray(good[found.variance[good] <= _FOREIGN * median(found.variance[good])])


@exact_kernel
def _pixel_noise(image: Image, plain_px: Array, half: int) -> float:
    """Variance of the grey values between neighbours in squares of `2 half + 1` pixels, the median of the places.

    Infinite, that is unknown, without a place in the picture.
    """
    height, width = image.shape
    found = np.empty(len(plain_px))
    places = 0
    for k in range(len(plain_px)):
        x0, y0 = round(plain_px[k, 0]), round(plain_px[k, 1])
        if not (half <= x0 < width - half and half <= y0 < height - half):
            continue
        total = 0.0
        for y in range(y0 - half, y0 + half + 1):
            for x in range(x0 - half, x0 + half):
                total += (float(image[y, x + 1]) - float(image[y, x])) ** 2
        for y in range(y0 - half, y0 + half):
            for x in range(x0 - half, x0 + half + 1):
                total += (float(image[y + 1, x]) - float(image[y, x])) ** 2
        found[places] = total / (2 * 2 * (2 * half + 1) * 2 * half)
        places += 1
    return max(median(found[:places]), LEAST_VARIANCE) if places else math.inf
