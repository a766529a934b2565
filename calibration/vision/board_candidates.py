"""Where in a picture a checkerboard may be: clusters of saddle points of the grey values.

`cv2.findChessboardCorners` takes half a second to find nothing in a noisy 640x480 picture and ten at 1920x1080, so it
is only shown places that have the board's corners' look.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from model.arrays import Array

Box = tuple[int, int, int, int]

# The search runs on a picture of about this width: corners need no more.
_WIDTH_PX = 960
_SMOOTH_PX = 1.3
# A saddle of less curvature [grey / px^2] than a faint board's, or than so many typical ones of the picture, is noise.
_FAINT = 1.5
_ABOVE_NOISE = 7.0
# Saddles much flatter than the strongest ones belong to something else.
_OF_STRONGEST = 0.3
_MOST_SADDLES = 600
# Saddles within so many typical distances belong together, and so many of the board's must be seen.
_TOGETHER = 2.0
_ENOUGH = 0.6
_MOST_PLACES = 3


def board_candidates(image: Image, corners: int) -> list[Box]:
    """Boxes (x0, y0, x1, y1) in which a board of so many inner corners may be, the likeliest first."""
    height, width = image.shape
    scale = max(1, round(width / _WIDTH_PX))
    small = image
    if scale > 1:
        small = np.asarray(
            cv2.resize(image, (width // scale, height // scale), interpolation=cv2.INTER_AREA), dtype=np.uint8
        )
    saddles = _saddles(small, corners)
    if len(saddles) < _ENOUGH * corners:
        return []
    apart = np.linalg.norm(saddles[:, None] - saddles, axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(axis=1)
    reach = _TOGETHER * np.maximum(nearest[:, None], nearest)
    label = _connected((apart <= reach) & (apart <= reach.T))
    sizes = np.bincount(label)
    found = []
    for group in np.argsort(-sizes)[:_MOST_PLACES]:
        if sizes[group] < _ENOUGH * corners:
            break
        members = saddles[label == group]
        margin = 3.0 * float(np.median(nearest[label == group])) + 8
        low = np.maximum((members.min(axis=0) - margin) * scale, 0).astype(int)
        high = np.minimum((members.max(axis=0) + margin) * scale + 1, (width, height)).astype(int)
        found.append((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
    return found


def _connected(linked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Label (n,) of the cluster that each point is in, from which are linked (n, n, symmetric)."""
    label = np.full(len(linked), -1)
    for point in range(len(linked)):
        reached = np.array([point]) if label[point] < 0 else np.empty(0, np.intp)
        while reached.size:
            label[reached] = label[point] if label[point] >= 0 else label.max() + 1
            reached = np.flatnonzero(linked[reached].any(axis=0) & (label < 0))
    return label


def _saddles(image: Image, corners: int) -> Array:
    """Saddle points (k, 2) [px], the strongest of the picture."""
    smooth = cv2.GaussianBlur(image, (0, 0), _SMOOTH_PX).astype(np.float32)
    xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=3, scale=0.25)
    yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=3, scale=0.25)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3, scale=0.25)
    # Minus the determinant of the Hessian: positive at a saddle, none at an edge, negative at a spot.
    strength = cv2.subtract(cv2.multiply(xy, xy), cv2.multiply(xx, yy))
    least = max(_FAINT, _ABOVE_NOISE * float(np.median(np.abs(xy[::4, ::4]))))
    peaks = (strength >= cv2.dilate(strength, np.ones((5, 5), np.uint8))) & (strength > least**2)
    y, x = np.nonzero(peaks)
    found = strength[y, x]
    order = np.argsort(-found)[:_MOST_SADDLES]
    if len(order) == 0:
        return np.empty((0, 2))
    strong = found[order[min(len(order), corners) // 2]]
    order = order[found[order] > _OF_STRONGEST**2 * strong]
    return np.stack([x[order], y[order]], axis=-1).astype(np.float64)
