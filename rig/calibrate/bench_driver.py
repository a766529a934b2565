"""Bench driver for calibration: regulates pressures or opens one valve by a voltage, with the run's interlocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.control import step as control
from rig.control.control_loop import ValveOutputs
from rig.control.interlocks import evaluation
from rig.control.interlocks.base import Sample, Trip
from rig.control.sensor_state import RegulatorDemand, SensorState
from rig.hardware.bench import Bench

Floats = NDArray[np.float64]


class TrippedError(Exception):
    """An interlock ended the procedure; the valves are safe, or vented where the `trip` vents."""

    def __init__(self, trip: Trip) -> None:
        super().__init__(trip.message)
        self.trip = trip


class BenchClock(Protocol):
    """The control periods, in real or virtual time."""

    def next(self) -> int:
        """Wait for the next control period; return its time [ns]."""


@dataclass(frozen=True)
class BenchLog:
    """Logged samples: `time_s` (n,), `pressure_pa` (n, N) and `signals` (n, N), one row per scan."""

    time_s: Floats
    pressure_pa: Floats
    signals: Floats


class BenchDriver:
    """Drives an armed bench. Every control cycle goes through the interlocks of a run; a trip makes safe and raises."""

    def __init__(self, config: RigConfig, bench: ValveOutputs, clock: BenchClock, check: Callable[[], None]) -> None:
        """`check` is called at every control cycle and raises on a stop request of the operator."""
        self._config, self._bench, self._clock, self._check = config, bench, clock, check
        self._prepared = control.prepare(config)
        self._period_s = self._prepared.period_s
        self._period_ns = round(self._period_s * 1e9)
        self._signals = np.full(config.actuators, np.nan)
        self._pressure_pa = np.full(config.actuators, np.nan)
        self._scan_t_ns = 0
        self._stops_closed = (True,) * len(config.emergency_stops)

    @property
    def pressure_pa(self) -> Floats:
        """The newest pressures (N,)."""
        return self._pressure_pa

    def regulate(self, setpoint_pa: Floats, seconds: float, until: Callable[[], bool] | None = None) -> BenchLog:
        """Regulate pressures (N,) for `seconds`, or until `until` returns True."""
        state = control.initial(self._prepared)
        still = np.zeros_like(setpoint_pa)
        rows = _RowBuffer()
        for now in self._period(seconds, until):
            rows.take(*self._listen())
            state, command = control.step(self._prepared, state, self._sample(now), setpoint_pa, still)
            self._bench.write(command.outputs)
            if command.trip is not None:
                raise TrippedError(command.trip)
        return rows.log()

    def open_valve(self, valve: int, offset_v: float, seconds: float, band_pa: float = math.inf) -> BenchLog:
        """Open one flow-metering valve to an offset from its closed voltage, for `seconds` or until the pressure
        changes by `band_pa`; the other valves are in their safe state.
        """
        command_v = np.array(self._prepared.safe_output)
        settings = self._prepared.valves[valve]
        command_v[valve] = settings.opening_v(offset_v)
        chambers = list(settings.actuators)
        states = (SensorState(),) * self._config.actuators
        start: float | None = None
        rows = _RowBuffer()
        before: int | None = None
        for now in self._period(seconds, None):
            rows.take(*self._listen())
            sample = self._sample(now)
            # The reference follows the reading, so only level, rate and a frozen reading can trip.
            demands = [
                RegulatorDemand(
                    math.nan, pressure, settings.opening_rate_pa_s(offset_v, pressure) if i in chambers else 0.0, 0.0
                )
                for i, pressure in enumerate(sample.pressure_pa.tolist())
            ]
            dt_s = self._period_s if before is None else (sample.scan_t_ns - before) * 1e-9
            states, trip = evaluation.evaluate(
                self._prepared.limits, states, sample, demands, dt_s, new=sample.scan_t_ns != before
            )
            before = sample.scan_t_ns
            if trip is not None:
                raise TrippedError(trip)
            self._bench.write(command_v)
            mean = float(sample.pressure_pa[chambers].mean())
            start = mean if start is None else start
            if abs(mean - start) > band_pa:
                break
        return rows.log()

    def _period(self, seconds: float, until: Callable[[], bool] | None) -> Iterator[int]:
        for _ in range(max(1, round(seconds / self._period_s))):
            self._check()
            yield self._clock.next()
            if until is not None and until():
                return

    def _listen(self) -> tuple[NDArray[np.int64], Floats, Floats]:
        scans = self._bench.read()
        self._stops_closed = scans.stops_closed
        if len(scans.t_ns):
            self._scan_t_ns = int(scans.t_ns[-1])
            self._pressure_pa, self._signals = scans.newest_pressure_pa(self._period_ns), scans.signals[-1]
        return scans.t_ns, scans.pressure_pa, scans.signals

    def _sample(self, now: int) -> Sample:
        return Sample(now, self._scan_t_ns, self._signals, self._pressure_pa, stops_closed=self._stops_closed)


@contextmanager
def made_safe(bench: Bench) -> Iterator[None]:
    """Arm the bench and sample; write the safe state whatever happens inside, and vent for a trip that vents."""
    vent = False
    try:
        bench.arm()
        bench.start()
        yield
    except TrippedError as error:
        vent = error.trip.vent
        raise
    finally:
        bench.make_safe(vent=vent)


class _RowBuffer:
    def __init__(self) -> None:
        self._t: list[NDArray[np.int64]] = []
        self._p: list[Floats] = []
        self._signals: list[Floats] = []

    def take(self, t_ns: NDArray[np.int64], pressure_pa: Floats, signals: Floats) -> None:
        if len(t_ns):
            self._t.append(t_ns.copy())
            self._p.append(pressure_pa.copy())
            self._signals.append(signals.copy())

    def log(self) -> BenchLog:
        if not self._t:
            return BenchLog(np.empty(0), np.empty((0, 0)), np.empty((0, 0)))
        t = np.concatenate(self._t)
        return BenchLog((t - t[0]) * 1e-9, np.concatenate(self._p), np.concatenate(self._signals))
