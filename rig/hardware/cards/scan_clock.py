"""Scan times from the scan counter of a card, synchronised with CLOCK_MONOTONIC (phase-locked loop)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_WINDOW_NS = 2_000_000_000
_PHASE_GAIN = 0.5
_RATE_GAIN = 0.1
_LARGEST = 1e-3
"""Bound of the relative rate error, above that of any crystal; it keeps the times increasing."""


class ScanClock:
    """Time of scan i = start + (i + 1) * period, the period corrected for the drift between the two crystals.

    The anchor is the time just before the command: the first scan comes one period later, so the anchor is uncertain by
    less than a period. Scans reach the program with an unknown, varying delay, never early; the drift of the shortest
    delay in each two seconds is the difference between the crystals (20-100 ppm: uncorrected, 0.1 s in 20 minutes).
    """

    def __init__(self, period_ns: float, start_ns: int) -> None:
        """`period_ns` is the period of the driver, `start_ns` the time just before the command."""
        self.period_ns = period_ns
        self._rate = 0.0
        self._last_ns = float(start_ns)
        self._begin(start_ns)

    def _begin(self, now_ns: float) -> None:
        self._phase_rate = 0.0
        self._floor_ns: float | None = None
        self._window_from_ns = float(now_ns)
        self._shortest_ns = np.inf

    @property
    def drift_ppm(self) -> float:
        """Relative error of the driver's period by CLOCK_MONOTONIC [ppm]; positive if the true period is longer."""
        return self._rate * 1e6

    def stamp(self, scans: int, now_ns: int) -> NDArray[np.int64]:
        """Times of the next `scans` scans, which were available at `now_ns`."""
        step = self.period_ns * (1 + float(np.clip(self._rate + self._phase_rate, -_LARGEST, _LARGEST)))
        times = self._last_ns + step * np.arange(1, scans + 1)
        if scans:
            self._last_ns = float(times[-1])
            self._shortest_ns = min(self._shortest_ns, now_ns - self._last_ns)
            if now_ns - self._window_from_ns >= _WINDOW_NS:
                self._steer(now_ns)
        return np.round(times).astype(np.int64)

    def _steer(self, now_ns: int) -> None:
        elapsed = now_ns - self._window_from_ns
        if self._floor_ns is None:
            self._floor_ns = self._shortest_ns
        error = (self._shortest_ns - self._floor_ns) / elapsed
        self._rate = float(np.clip(self._rate + _RATE_GAIN * error, -_LARGEST, _LARGEST))
        self._phase_rate = _PHASE_GAIN * error
        self._window_from_ns = float(now_ns)
        self._shortest_ns = np.inf

    def restart(self, start_ns: int) -> int:
        """Set a new anchor after an aborted command; return the number of scans that were not taken."""
        lost = max(0, int((start_ns - self._last_ns) // self.period_ns))
        self._last_ns = max(float(start_ns), self._last_ns)
        self._begin(start_ns)
        return lost
