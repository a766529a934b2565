"""When each scan was taken: a card's scan counter as a clock, kept in step with CLOCK_MONOTONIC."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_WINDOW_NS = 2_000_000_000
_PHASE_GAIN = 0.5
_RATE_GAIN = 0.1
_LARGEST = 1e-3
"""No crystal is further off; it keeps the times increasing whatever the delays do."""


class ScanClock:
    """Time of scan i = start + (i + 1) * period, the period corrected for the drift between the two crystals.

    The anchor is the moment just before the command was given: a pacer ticks for the first time one period later, so
    the anchor is uncertain by less than a period. Scans reach the program late by an unknown, varying delay, but never
    early; the shortest delay in each two seconds is that of an idle machine, and what it drifts by is the difference
    between the crystals (20-100 ppm: uncorrected, 0.1 s in twenty minutes).
    """

    def __init__(self, period_ns: float, start_ns: int) -> None:
        """`period_ns` is what the driver says, `start_ns` the moment just before the command."""
        self._period_ns = period_ns
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
        """How much longer the card's period is than the driver says, by CLOCK_MONOTONIC, in parts per million."""
        return self._rate * 1e6

    def stamp(self, scans: int, now_ns: int) -> NDArray[np.int64]:
        """Times of the next `scans` scans, which were there at `now_ns`."""
        step = self._period_ns * (1 + float(np.clip(self._rate + self._phase_rate, -_LARGEST, _LARGEST)))
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
        """Anchor anew after a command that broke off; return how many scans were never taken."""
        lost = max(0, int((start_ns - self._last_ns) // self._period_ns))
        self._last_ns = max(float(start_ns), self._last_ns)
        self._begin(start_ns)
        return lost
