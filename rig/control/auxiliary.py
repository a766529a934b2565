"""Auxiliary inputs between control cycles: each value is the mean of the scans of its period."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig


class AuxiliaryMeans:
    """The newest values of the auxiliary inputs, each renewed at its own rate by the times of the scans."""

    def __init__(self, config: RigConfig) -> None:
        """The inputs of a rig, at least one."""
        rates_hz = [one.rate_hz or config.control.rate_hz for one in config.inputs.values()]
        self._periods_ns = np.array([round(1e9 / rate) for rate in rates_hz])
        self._due_ns = np.zeros(len(rates_hz), np.int64)
        self._sum = np.zeros(len(rates_hz))
        self._count = 0 * self._due_ns
        self.value: NDArray[np.float64] = np.full(len(rates_hz), np.nan)
        """Newest values (I,); NaN before the first, or where a scan was outside the span."""

    def add(self, t_ns: NDArray[np.int64], scans: NDArray[np.float64]) -> None:
        """Take new scans (n,), (n, I)."""
        if len(t_ns) == 0:
            return
        self._sum += scans.sum(axis=0)
        self._count += len(t_ns)
        now_ns = int(t_ns[-1])
        due = now_ns >= self._due_ns
        self.value[due] = self._sum[due] / self._count[due]
        self._sum[due], self._count[due] = 0.0, 0
        # A period that was missed, as in a stall, is not made up for.
        late = due & (self._due_ns + 2 * self._periods_ns <= now_ns)
        self._due_ns[due] += self._periods_ns[due]
        self._due_ns[late] = now_ns + self._periods_ns[late]
