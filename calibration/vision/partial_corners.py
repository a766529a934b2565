"""Corners of a board of which some may be hidden: those that look as they must are kept, each with its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.vision.corner_model import LEAST_VARIANCE, TAPER_PX, CornerFit, edge_shape, fit
from calibration.vision.corners import (
    BLUR_CERTAIN,
    BLUR_OPINION,
    COARSE,
    KNOT_BLURS,
    LEAST_KNOT_PX,
    MOVES_CORNERS,
    RADIUS_BOUNDS_PX,
    START_BLUR_PX,
    TOLD_BY_CHANCE,
    Corners,
    column_medians,
    light_gradient,
    uncertainty,
)

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Indices = NDArray[np.intp]

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

    toward: Floats
    bright: NDArray[np.bool_]
    clear_m: float
    quadrant: bool = False
    systematic_px: float = 0.0
    unexplained: float = 0.0


def plane_to_image(points_m: Floats, px: Floats) -> Floats | None:
    """Homography (3, 3) of points (n, 3) of a plane to pixels (n, 2) in least squares; None if they lie in a line."""
    if len(points_m) < 4:
        return None
    found, _ = cv2.findHomography(points_m[:, :2], np.ascontiguousarray(px))
    return None if found is None else np.asarray(found, dtype=np.float64)


def mapped(homography: Floats, points_m: Floats) -> Floats:
    """Pixels (n, 2) of points (n, 3) of the plane."""
    moved = points_m[:, :2] @ homography[:, :2].T + homography[:, 2]
    return np.asarray(moved[:, :2] / moved[:, 2:])


def sharpen_seen(
    image: Image, points_m: Floats, seeds_px: Floats, kind: CornerKind, plain_px: Floats
) -> Corners | None:
    """Refine those of the corners `points_m` (n, 3), known to a few pixels, that are not hidden.

    `plain_px` (k, 2) are places of one colour, from which the noise of the pixels is estimated. None if no corner looks
    as it must.
    """
    homography = plane_to_image(points_m, seeds_px)
    if homography is None:
        return None
    smallest, largest = RADIUS_BOUNDS_PX
    clear_px = kind.clear_m * _least_scale(homography, points_m)
    radius = min(max(clear_px - TAPER_PX / 2 - _CLEAR_OF_EDGES_PX, smallest), largest)
    kept, px = _coarse(image, seeds_px, math.floor(radius))
    homography = plane_to_image(points_m[kept], px) if len(kept) > 4 else homography
    if homography is None or not len(kept):
        return None

    def fitted(light: Floats, shape: Floats, knot: float, blur: Floats, firmness: float) -> tuple[Indices, CornerFit]:
        normals = _normals(homography, points_m[kept], kind.toward[kept])
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
        normals = _normals(homography, points_m[kept], kind.toward[kept])
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
    least = max(_LEAST_STEP_GREY, _LEAST_STEP * float(np.median(step)))
    good = good[(step > least) & (found.misfit[good] < _MAX_MISFIT)]
    if not len(good):
        return good
    return np.asarray(good[found.variance[good] <= _FOREIGN * np.median(found.variance[good])])


def _least_scale(homography: Floats, points_m: Floats) -> float:
    """Smallest pixels per metre at points (n, 3), in the direction in which the plane is foreshortened most."""
    along, down = _directions(homography, points_m)
    area = np.abs(along[:, 0] * down[:, 1] - along[:, 1] * down[:, 0])
    return float((area / np.maximum(np.hypot(*along.T), np.hypot(*down.T))).min())


def _directions(homography: Floats, points_m: Floats) -> tuple[Floats, Floats]:
    """Pixels per metre (n, 2) along the board's x axis, and down against its y axis."""
    w = points_m[:, :2] @ homography[2, :2] + homography[2, 2]
    px = mapped(homography, points_m)
    along = (homography[:2, 0] - px * homography[2, 0]) / w[:, None]
    down = -(homography[:2, 1] - px * homography[2, 1]) / w[:, None]
    return along, down


def _normals(homography: Floats, points_m: Floats, toward: Floats) -> Floats:
    """Unit normals (n, 2, 2) of the edges along the board's y axis and along its x axis, on the side of `toward`."""
    along, down = _directions(homography, points_m)
    normals = np.empty((len(points_m), 2, 2))
    for k, (edge, side, sign) in enumerate(((down, along, toward[:, 0]), (along, down, toward[:, 1]))):
        normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1) / np.hypot(*edge.T)[:, None]
        normals[:, k] = normal * (sign * np.sign(np.sum(normal * side, axis=1)))[:, None]
    return normals


def _coarse(image: Image, seeds_px: Floats, half: int) -> tuple[Indices, Floats]:
    """To a tenth of a pixel by OpenCV: the corners that it moves, but not far, and that lie off the border."""
    height, width = image.shape
    margin = half + 3
    limits = np.array([width - 1 - margin, height - 1 - margin])

    def inside(px: Floats) -> NDArray[np.bool_]:
        return np.asarray(((px >= margin) & (px <= limits)).all(axis=1))

    kept = np.flatnonzero(inside(seeds_px))
    if not len(kept):
        return kept, np.empty((0, 2))
    start = seeds_px[kept].astype(np.float32).reshape(-1, 1, 2)
    coarse = cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), COARSE)
    moved = np.abs(coarse - start).max(axis=(1, 2))
    found = np.asarray(coarse[:, 0, :], dtype=np.float64)
    # Where the iteration diverges OpenCV returns its seed, to the last bit.
    good = (moved <= half) & (moved > 0) & inside(found)
    return kept[good], found[good]


def _pixel_noise(image: Image, plain_px: Floats, half: int) -> float:
    """Variance of the grey values between neighbours in squares of `2 half + 1` pixels, the median of the places.

    Infinite, that is unknown, without a place in the picture.
    """
    height, width = image.shape
    found = []
    for x, y in np.rint(plain_px).astype(int):
        if half <= x < width - half and half <= y < height - half:
            patch = image[y - half : y + half + 1, x - half : x + half + 1].astype(np.float64)
            changes = np.concatenate([np.diff(patch, axis=0).ravel(), np.diff(patch, axis=1).ravel()])
            found.append(float(np.mean(changes**2)) / 2)
    return max(float(np.median(found)), LEAST_VARIANCE) if found else math.inf
