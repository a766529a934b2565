"""Periods of set-points that repeat."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runs.arrays import Array

TOLERANCE = 0.02
"""Largest relative deviation of a period from their median."""
_MISSING = 0.01
"""Part of a period that may be missing at the end of whole ones: the time from the last row to the next."""


def last_period(time_s: Array, setpoint_bar: Array) -> tuple[float, float] | None:
    """Return start and end [s] of the last of `period_bounds`; None if the set-points do not repeat."""
    bounds = period_bounds(time_s, setpoint_bar)
    return None if bounds is None else (float(bounds[-2]), float(bounds[-1]))


def whole_periods(time_s: Array, setpoint_bar: Array) -> Array | None:
    """Return the bounds (k + 1,) [s] of as many periods as fit, from the first row on; None if they do not repeat.

    Their length is the mean of those of `period_bounds`, which leaves the parts before and after the crossings out.
    """
    crossings = period_bounds(time_s, setpoint_bar)
    if crossings is None:
        return None
    period_s = float(np.diff(crossings).mean())
    count = int((time_s[-1] - time_s[0]) / period_s + _MISSING)
    return np.asarray(time_s[0] + period_s * np.arange(count + 1))


def period_bounds(time_s: Array, setpoint_bar: Array) -> Array | None:
    """Return the bounds (k + 1,) [s] of the whole periods of set-points (n, actuators); None if they do not repeat.

    A period lies between two upward crossings of the mid-range, interpolated, of the actuator that moves most.
    """
    if len(time_s) < 2 or not np.isfinite(setpoint_bar).all():
        return None
    wave = setpoint_bar[:, np.argmax(np.ptp(setpoint_bar, axis=0))]
    if np.ptp(wave) == 0:
        return None
    above = wave - (wave.max() + wave.min()) / 2
    rising: NDArray[np.intp] = np.flatnonzero((above[:-1] < 0) & (above[1:] >= 0))
    part: NDArray[Any] = above[rising] / (above[rising] - above[rising + 1])
    crossings = time_s[rising] + part * (time_s[rising + 1] - time_s[rising])
    periods = np.diff(crossings)
    if len(periods) == 0 or np.abs(periods / np.median(periods) - 1).max() > TOLERANCE:
        return None
    return np.asarray(crossings)
