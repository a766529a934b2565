"""Grey values between pixels, and whether the cells of markers are dark and bright as they are printed."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from model.arrays import Array
from model.kernels.jit import kernel

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)


@exact_kernel
def grey_at(image: Image, x: float, y: float) -> float:
    """Grey value at a place, bilinear between pixels; NaN outside the picture."""
    height, width = image.shape
    if not (0.0 <= x <= width - 1 and 0.0 <= y <= height - 1):
        return math.nan
    x0, y0 = min(int(x), width - 2), min(int(y), height - 2)
    fx, fy = x - x0, y - y0
    above = (1.0 - fx) * image[y0, x0] + fx * image[y0, x0 + 1]
    below = (1.0 - fx) * image[y0 + 1, x0] + fx * image[y0 + 1, x0 + 1]
    return float((1.0 - fy) * above + fy * below)


@exact_kernel
def markers_seen(
    image: Image,
    spots_px: Array,
    dark: NDArray[np.bool_],
    least_contrast: float,
    side_margin: float,
    seen: NDArray[np.bool_],
) -> None:
    """Fill which markers (m,) show all their cells.

    `dark` (m, cells) says which are printed dark; a cell is the mean of its share of `spots_px` (m cells spots, 2). It
    must stand `side_margin` clear of the middle between the marker's mean dark and mean bright, 0 and 1, which differ
    by `least_contrast` grey levels or more.
    """
    markers, cells = dark.shape
    spots = len(spots_px) // (markers * cells)
    grey = np.empty(cells)
    for m in range(markers):
        low = high = 0.0
        darks = 0
        for c in range(cells):
            total = 0.0
            for k in range(spots):
                x, y = spots_px[(m * cells + c) * spots + k]
                total += grey_at(image, x, y)
            grey[c] = total / spots
            if dark[m, c]:
                low += grey[c]
                darks += 1
            else:
                high += grey[c]
        low, high = low / darks, high / (cells - darks)
        # False where a spot lies outside the picture.
        seen[m] = high - low >= least_contrast
        for c in range(cells):
            side = (grey[c] - low) / (high - low) - 0.5
            if not (-side if dark[m, c] else side) > side_margin:
                seen[m] = False
