"""Values of the control cycles at the time of a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array

Times = NDArray[np.int64]

_HISTORY_NS = 1_000_000_000


class SampleInterpolator:
    """Linear interpolation of the samples of the last second: pressures, forces or protocol times."""

    def __init__(self, columns: int) -> None:
        self._t_ns: Times = np.empty(0, np.int64)
        self._values: Array = np.empty((0, columns))

    def extend(self, t_ns: Times, values: Array) -> None:
        """Append samples `t_ns` (k,), `values` (k, n); samples that are not newer than the last are ignored."""
        if self._t_ns.size:
            new = t_ns > self._t_ns[-1]
            t_ns, values = t_ns[new], values[new]
        if t_ns.size:
            keep = self._t_ns > t_ns[-1] - _HISTORY_NS
            self._t_ns = np.concatenate([self._t_ns[keep], t_ns])
            self._values = np.concatenate([self._values[keep], values])

    @property
    def first_ns(self) -> int | None:
        """Time of the first sample that is kept; None before any."""
        return int(self._t_ns[0]) if self._t_ns.size else None

    def at(self, t_ns: int) -> Array:
        """Return the values (n,) at a time, the nearest sample beyond the ends; NaN before the first."""
        if not self._t_ns.size:
            return np.full(self._values.shape[1], np.nan)
        after = int(np.searchsorted(self._t_ns, t_ns))
        if after == 0 or after == len(self._t_ns) or self._t_ns[after] == t_ns:
            return np.array(self._values[min(after, len(self._t_ns) - 1)])
        # Subtract in int64: a float64 cannot represent nanoseconds since boot exactly.
        before_ns = int(self._t_ns[after - 1])
        share = (t_ns - before_ns) / (int(self._t_ns[after]) - before_ns)
        return np.array(self._values[after - 1] + share * (self._values[after] - self._values[after - 1]))
