"""Faults of a picture's exposure that hide a board."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_WHITE, _BLACK = 250, 16
"""Grey levels at and above, at and below which a pixel shows no detail."""
_MOST_WHITE = 0.25
_MOST_BLACK = 0.9


def exposure_fault(image: NDArray[np.uint8]) -> str:
    """Return the exposure fault of a grey picture (height, width) with the share of pixels; empty if there is none."""
    white, black = float(np.mean(image >= _WHITE)), float(np.mean(image <= _BLACK))
    if white > _MOST_WHITE:
        return f"the picture is overexposed ({100 * white:.0f} % of its pixels are white)"
    if black > _MOST_BLACK:
        return f"the picture is underexposed ({100 * black:.0f} % of its pixels are black)"
    return ""
