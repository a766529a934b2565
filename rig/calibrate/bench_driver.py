"""Bench driver for calibration: regulates pressures or opens one valve by a voltage, with the run's interlocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from rig.config.schema import RigConfig
from rig.control import step as control
from rig.control.bench_reader import BenchReader
from rig.control.control_loop import ValveOutputs
from rig.control.interlocks import evaluation
from rig.control.interlocks.base import Trip
from rig.control.sensor_state import RegulatorDemand, SensorState
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import SafeOutputs
from rig.valves.metering import MeteringRegulator

_LONGEST_INTERVALS = 1.5
"""Between two scans, of the usual interval; in a longer one the time of a simulated bench stops."""


class TrippedError(Exception):
    """An interlock ends the procedure; the armed bench is then made safe, or vented where the `trip` vents."""

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

    time_s: Array
    pressure_pa: Array
    signals: Array


class BenchDriver:
    """Drives an armed bench. Every control cycle goes through the interlocks of a run; a trip raises `TrippedError`."""

    def __init__(
        self,
        config: RigConfig,
        bench: ValveOutputs,
        clock: BenchClock,
        check: Callable[[], None],
        *,
        longest_stop_ns: int | None = None,
    ) -> None:
        """`check` is called at every control cycle and raises on a stop request of the operator.

        With `longest_stop_ns` the bench is a simulation whose time stops while it or this process is delayed, but no
        longer. All durations are then those of the bench.
        """
        self._config, self._bench, self._clock, self._check = config, bench, clock, check
        self._prepared = control.prepare(config)
        self._period_s = self._prepared.period_s
        self._readings = BenchReader(config, bench, time_may_stop=longest_stop_ns is not None)
        self._longest_stop_ns = longest_stop_ns
        self._scan_interval_s = 1.0 / min(card.sampling_hz for card in config.cards.values())
        self._passed_s = self._period_s

    @property
    def pressure_pa(self) -> Array:
        """The newest pressures (N,)."""
        return self._readings.pressure_pa

    def regulate(self, setpoint_pa: Array, seconds: float, until: Callable[[], bool] | None = None) -> BenchLog:
        """Regulate pressures (N,) for `seconds`, or until `until` returns True."""
        state = control.initial(self._prepared)
        still = np.zeros_like(setpoint_pa)
        rows = self._row_buffer()
        for now in self._period(seconds, until):
            rows.take(*self._listen())
            state, command = control.step(self._prepared, state, self._readings.sample(now), setpoint_pa, still)
            if command.trip is not None:
                raise TrippedError(command.trip)
            self._bench.write(command.outputs)
        return rows.log()

    def open_valve(self, valve: int, offset_v: float, seconds: float, band_pa: float = math.inf) -> BenchLog:
        """Open one flow-metering valve to an offset from its closed voltage, for `seconds` or until the pressure
        changes by `band_pa`; the other valves are in their safe state.
        """
        command_v = SafeOutputs.of(self._config.valves).held.copy()
        settings = self._prepared.valves[valve]
        assert isinstance(settings, MeteringRegulator)
        command_v[valve] = settings.opening_v(offset_v)
        chambers = list(settings.actuators)
        states = (SensorState(),) * self._config.actuators
        start: float | None = None
        rows = self._row_buffer()
        before: int | None = None
        for now in self._period(seconds, None):
            rows.take(*self._listen())
            sample = self._readings.sample(now)
            # The reference follows the reading, so only level, rate and a frozen reading can trip.
            demands = [
                RegulatorDemand(
                    math.nan, pressure, settings.opening_rate_pa_s(offset_v, pressure) if i in chambers else 0.0, 0.0
                )
                for i, pressure in enumerate(sample.pressure_pa.tolist())
            ]
            dt_s = self._period_s if before is None else (sample.scan_t_ns - before) * 1e-9
            timers_s = self._period_s if sample.time_stopped and sample.stalled_ns else dt_s
            new = sample.scan_t_ns != before
            states, trip = evaluation.evaluate(
                self._prepared.limits, states, sample, demands, dt_s, new=new, timers_s=timers_s
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
        while self._longest_stop_ns is not None and not self._readings.scan_t_ns:
            self._check()
            self._clock.next()
            self._listen()
        left_s = max(self._period_s, seconds)
        while left_s > self._period_s / 2:
            self._check()
            yield self._clock.next()
            left_s -= self._passed_s
            if until is not None and until():
                return

    def _listen(self) -> tuple[NDArray[np.int64], Array, Array]:
        scans = self._readings.read()
        self._passed_s = self._period_s
        if self._longest_stop_ns is not None:
            self._passed_s = len(scans.t_ns) * self._scan_interval_s
            if (late_ns := self._readings.late_ns) > self._longest_stop_ns:
                raise CardError(f"the simulator has stalled for {late_ns * 1e-9:.1f} s")
        return scans.t_ns, scans.pressure_pa, scans.signals

    def _row_buffer(self) -> _RowBuffer:
        return _RowBuffer(None if self._longest_stop_ns is None else self._scan_interval_s)


class _RowBuffer:
    """Rows of a log. With `interval_s` that of the scans: during a longer one the time of the bench stops."""

    def __init__(self, interval_s: float | None) -> None:
        self._interval_s = interval_s
        self._t: list[NDArray[np.int64]] = []
        self._p: list[Array] = []
        self._signals: list[Array] = []

    def take(self, t_ns: NDArray[np.int64], pressure_pa: Array, signals: Array) -> None:
        if len(t_ns):
            self._t.append(t_ns.copy())
            self._p.append(pressure_pa.copy())
            self._signals.append(signals.copy())

    def log(self) -> BenchLog:
        if not self._t:
            return BenchLog(np.empty(0), np.empty((0, 0)), np.empty((0, 0)))
        t = np.concatenate(self._t)
        steps_s = np.diff(t, prepend=t[0]) * 1e-9
        if self._interval_s is not None:
            steps_s[steps_s > _LONGEST_INTERVALS * self._interval_s] = self._interval_s
        return BenchLog(np.cumsum(steps_s), np.concatenate(self._p), np.concatenate(self._signals))
