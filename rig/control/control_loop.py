"""The control loop: one cycle reads scans, steps the regulators, writes the valves and returns the row to record.

The real-time and the virtual executor use the same code.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from rig.config.schema import RigConfig
from rig.control import step as control
from rig.control.bench_reader import BenchReader, Readable
from rig.control.interlocks.base import Trip
from rig.control.limiter import Limiter
from rig.control.plan_follower import PlanFollower, SetPointSource, StampedPlan
from rig.control.protocol_position import ProtocolPosition, advance, skip
from rig.control.setpoints import Moment, RunSetPoints
from rig.control.stream_follower import StreamFollower
from rig.execution.plan import RunPlan, sample_rows
from rig.hardware.safe_state import SafeOutputs
from runs.records import SolveStatus, blank


class ValveOutputs(Readable, Protocol):
    """What a control cycle needs of a bench."""

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set every valve [V]."""


class ControlLoop:
    """The state of the control loop between cycles. It reads no clock: the caller passes the time."""

    def __init__(self, plan: RunPlan, bench: ValveOutputs, *, time_may_stop: bool = False) -> None:
        """`time_may_stop`: the bench is a simulation whose time stops while it or this process is delayed."""
        config = plan.config
        self.period_ns = round(1e9 / config.control.rate_hz)
        self.position = ProtocolPosition()
        self._bench = bench
        self.readings = BenchReader(config, bench, time_may_stop=time_may_stop)
        self._trajectory = plan.trajectory
        self._prompts_s = tuple(prompt.at_s for prompt in plan.trajectory.prompts)
        self._starts_s = tuple(segment.start_s for segment in plan.trajectory.segments)
        self._prepared = control.prepare(config)
        self._state = control.initial(self._prepared)
        self._row = blank((), sample_rows(config))
        self._auxiliary = _AuxiliaryMeans(config) if config.inputs else None
        self._follower = _plan_follower(plan) if plan.controls_tip else None
        self._stream = StreamFollower(config, plan.trajectory) if plan.trajectory.streams else None
        live = tuple(source for source in (self._stream, self._follower) if source is not None)
        self._setpoints = RunSetPoints(plan.trajectory, live)
        self._limiter = Limiter.of(config)
        self._stopped = False
        self._safe_outputs = SafeOutputs.of(config.valves)
        self._has_voltage = np.array([valve.output_unit == "V" for valve in config.valves])

    @property
    def finished(self) -> bool:
        """True once the protocol has reached its end."""
        return self.position.protocol_s >= self._trajectory.duration_s

    @property
    def setpoint_source(self) -> SetPointSource:
        """Where the set-points of the last cycle came from."""
        return SetPointSource.PROTOCOL if self._follower is None else self._follower.source

    def take_plan(self, plan: StampedPlan, row: NDArray[np.void] | np.void) -> NDArray[np.void] | np.void:
        """Follow a plan of the tip controller, or refuse it; return its row for the record, completed.

        Refused is what the plan follower cannot follow, and every plan where the tip has no reference now.
        """
        now_s = self.position.protocol_s
        row["late_s"] = now_s - row["start_s"]
        if self._follower is None:
            row["status"] = SolveStatus.NO_PATH
        elif (reason := self._follower.take(now_s, *plan)) is not None:
            row["status"] = reason
        return row

    def take_setpoint(self, row: NDArray[np.void] | np.void, now_ns: int) -> NDArray[np.void] | np.void:
        """Follow a set-point of another program, or refuse it; return its row for the record, completed."""
        assert self._stream is not None
        return self._stream.take(row, now_ns, self.position.protocol_s, stopped=self._stopped)

    def skip(self) -> None:
        """Continue with the next segment in the next cycle."""
        self.position = skip(self.position, self._starts_s, self._trajectory.duration_s, self._prompts_s)
        self._setpoints.skip()

    def read_scans(self) -> int:
        """Read the scans since the last call; return their number."""
        scans = self.readings.read()
        if self._auxiliary is not None:
            self._auxiliary.add(scans.t_ns, scans.auxiliary)
        return len(scans.t_ns)

    def cycle(
        self, number: int, now_ns: int, periods: int, prompts_answered: int, paused: bool, lateness_ns: int, missed: int
    ) -> tuple[NDArray[np.void], Trip | None]:
        """Run one cycle; return its row (reused: copy it to keep it) and why the run must stop, else None.

        With a trip nothing is written: the caller leaves the armed bench, which writes the safe state at once.

        `periods` is the number of control periods since the last cycle: more than one after a missed deadline.
        """
        taken, dt_s = self.read_scans(), periods * self.period_ns * 1e-9
        if number > 0:
            self.position = advance(self.position, dt_s, self._prompts_s, prompts_answered, paused)
        protocol_s = min(self.position.protocol_s, self._trajectory.duration_s)
        self._stopped = paused or self.position.waiting
        now = Moment(protocol_s, dt_s, self._stopped, self._limiter.last_pa)
        wanted = self._setpoints.at(now)
        setpoint_pa, rate_pa_s = self._limiter.limit(wanted, now, live=self._setpoints.live)
        sample = self.readings.sample(now_ns, lateness_ns + missed * self.period_ns, self._setpoints.silences)
        self._state, command = control.step(self._prepared, self._state, sample, setpoint_pa, rate_pa_s)
        outputs = command.outputs
        if command.trip is None:
            self._bench.write(outputs)
        else:
            # The record has what the caller's bench writes as it is left.
            outputs = self._safe_outputs.values(vent=command.trip.vent)
        row = self._row
        row["t_ns"] = sample.scan_t_ns
        row["cycle"] = number
        row["protocol_s"] = protocol_s
        row["setpoint_pa"] = setpoint_pa
        row["measured_pa"] = sample.pressure_pa
        row["valve_v"] = np.where(self._has_voltage, outputs, np.nan)
        if not self._has_voltage.all():
            row["valve_output"] = outputs
        if self._auxiliary is not None:
            row["aux"] = self._auxiliary.value
        row["scans"] = taken
        row["missed"] = missed
        row["lateness_ns"] = lateness_ns
        return row, command.trip


def _plan_follower(plan: RunPlan) -> PlanFollower:
    """The follower of the plans of a run whose tip a controller steers."""
    config, tip = plan.config, plan.trajectory.tip
    return PlanFollower(
        config.valve_of,
        config.limits.pressure_bar * PA_PER_BAR,
        config.tip_control.no_plan_s,
        lambda protocol_s: tip.motion_at(protocol_s) is not None,
    )


class _AuxiliaryMeans:
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
