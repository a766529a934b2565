"""Rows that are missing from a table, made visible: a row of NaN stands in each gap, so that no curve bridges it."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from runs.arrays import Array
from runs.columns import DetectionStatus, Pressure, Tip

LONGER = 5.0
"""A time between two rows that is so many times the usual one is a gap."""
Rows = NDArray[np.intp]
T = TypeVar("T", Tip, Pressure)


def after_gaps(time_s: Array, dropped: NDArray[np.integer[Any]] | None = None) -> Rows:
    """Return the rows that come after a gap: after `dropped` frames, or after an unusually long time."""
    steps = np.diff(time_s)
    if len(steps) == 0:
        return np.zeros(0, np.intp)
    gap = steps > LONGER * np.median(steps)
    if dropped is not None:
        gap |= dropped[1:] > 0
    return np.flatnonzero(gap) + 1


def with_gaps(values: NDArray[Any], rows: Rows, missing: float = np.nan) -> NDArray[Any]:
    """Return values (n, ..) with one more before each of these rows."""
    return np.insert(values, rows, missing, axis=0)


def tip_with_gaps(tip: Tip) -> tuple[Tip, Rows]:
    """Return the camera frames with a row for each gap, and the rows after the gaps."""
    rows = after_gaps(tip.time_s, tip.dropped)
    return _opened(tip, rows).replaced(seen=with_gaps(tip.seen, rows, DetectionStatus.NO_FRAME)), rows


def pressure_with_gaps(pressure: Pressure) -> Pressure:
    """Return the control cycles with a row for each gap."""
    return _opened(pressure, after_gaps(pressure.time_s))


def _opened(table: T, rows: Rows) -> T:
    opened = {name: with_gaps(c, rows, np.nan if c.dtype.kind == "f" else 0) for name, c in table.values.items()}
    # Time continues in a gap.
    for name in ("time_s", "protocol_s"):
        times = table.values[name]
        opened[name] = np.insert(times, rows, (times[rows - 1] + times[rows]) / 2)
    return table.replaced(**opened)
