"""Linear interpolation of columns over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runs.arrays import Array


def interpolated(times_s: NDArray[Any] | float, at_s: NDArray[Any], values: NDArray[Any]) -> Array:
    """Columns of values (n, m) at times, linear in between; at the ends the first and the last."""
    found: Array = np.stack([np.interp(times_s, at_s, column) for column in values.T], axis=-1)
    return found
