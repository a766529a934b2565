"""The newest readings of a bench, of which each control cycle takes its sample.

Runs and calibrations use the same code.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.control.interlocks.base import Sample, Silence
from rig.hardware.bench import BenchScans

STALLED_NS = 20_000_000
"""A delay from which a cycle counts as stalled: four control periods at 200 Hz."""
COMPENSATED_NS = 100_000_000
"""Time for a card or its simulator to deliver the scans of a stall of this process."""


class Readable(Protocol):
    """A bench as far as it is read."""

    def read(self) -> BenchScans:
        """Scans since the last call."""


class BenchReader:
    """Reads a bench between control cycles. It reads no clock: the caller passes the time."""

    def __init__(self, config: RigConfig, bench: Readable, *, time_may_stop: bool = False) -> None:
        """`time_may_stop`: the bench is a simulation whose time stops while it or this process is delayed."""
        self._bench, self._time_may_stop = bench, time_may_stop
        self._period_ns = round(1e9 / config.control.rate_hz)
        self._stalls = _StallCompensation()
        self._stops_closed = (True,) * len(config.emergency_stops)
        self._signals: NDArray[np.float64] = np.full(config.actuators, np.nan)
        self.pressure_pa: NDArray[np.float64] = np.full(config.actuators, np.nan)
        """The newest pressures (N,), NaN before the first scan."""
        self.scan_t_ns = 0
        """Time of the newest scan, 0 before the first."""
        self.late_ns = 0
        """How far the time of a simulated bench that may stop is behind."""
        self.lost = 0
        """Scans that the cards have dropped."""
        self.damaged = 0
        """Lines between computer and cards that were damaged."""
        self.repeated = 0
        """Scans that the cards have delivered twice."""

    def read(self) -> BenchScans:
        """Read and return the scans since the last call."""
        scans = self._bench.read()
        self.lost += scans.lost
        self.damaged += scans.damaged
        self.repeated += scans.repeated
        self.late_ns = scans.late_ns if self._time_may_stop else 0
        self._stops_closed = scans.stops_closed
        if len(scans.t_ns):
            self.scan_t_ns = int(scans.t_ns[-1])
            self.pressure_pa = scans.newest_pressure_pa(self._period_ns)
            self._signals = scans.signals[-1]
        return scans

    def sample(self, now_ns: int, behind_ns: int = 0, silences: tuple[Silence, ...] = ()) -> Sample:
        """The sample of the cycle at `now_ns`, which is late by `behind_ns`."""
        return Sample(
            now_ns,
            self.scan_t_ns,
            self._signals,
            self.pressure_pa,
            stalled_ns=self._stalls.stalled_ns(now_ns, max(behind_ns, self.late_ns)),
            time_stopped=self._time_may_stop,
            late_ns=self.late_ns,
            stops_closed=self._stops_closed,
            silences=silences,
        )


class _StallCompensation:
    """Remembers the last stall of a control loop, whose duration does not count against the bench for a while."""

    def __init__(self) -> None:
        self._stalled_ns = self._until_ns = 0

    def stalled_ns(self, now_ns: int, behind_ns: int) -> int:
        """Duration [ns] of a stall within the last COMPENSATED_NS, 0 if there was none; `behind_ns`: the delay now."""
        if behind_ns > STALLED_NS:
            self._stalled_ns, self._until_ns = behind_ns, now_ns + COMPENSATED_NS
        return self._stalled_ns if now_ns < self._until_ns else 0
