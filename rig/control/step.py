"""One control step: the interlocks, then the regulator of every valve. A pure step function without a clock."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.control import sensor_state
from rig.control.interlocks import evaluation
from rig.control.interlocks.base import Sample, Trip
from rig.control.limiter import reference_pa
from rig.control.sensor_state import RegulatorDemand, SensorState
from rig.hardware.safe_state import SafeOutputs
from rig.valves.base import Regulator, RegulatorState

UNMEASURED_PERIODS = 3.0
"""Periods without a scan after which a flow-metering valve is closed, because its flow is no longer measured."""

SHORTEST_STEP_PERIODS, LONGEST_STEP_PERIODS = 0.25, 4.0
"""Bounds of the time step between newest scans: the filters are designed for a steady rate."""


@dataclass(frozen=True)
class ControlSettings:
    """The settings of a rig in SI."""

    period_s: float
    armed_output: tuple[float, ...]
    """The output of each valve while its regulator has none: that of the armed bench."""
    closed_output: tuple[float | None, ...]
    """The output that closes each valve; None for a valve that keeps its output without a sample."""
    valves: tuple[Regulator, ...]
    valve_of: tuple[int, ...]
    """Index of the valve of each actuator."""
    limits: evaluation.InterlockSettings
    tracking_s: float


RESTART_S = 0.1
"""How long scans may be late after a stall, while a card or its simulator catches up."""


class ControlState(NamedTuple):
    """State between control steps. Once `trip` is set there are no more outputs.

    `restarted_ns` is the end of the last stall after which the timers of the interlocks were reset.
    """

    scan_t_ns: int | None
    valves: tuple[RegulatorState, ...]
    sensors: tuple[SensorState, ...]
    trip: Trip | None = None
    restarted_ns: int | None = None


class ControlOutput(NamedTuple):
    """Valve outputs (V,) to write now, each in its unit; or the trip that ends the run, and no outputs (0,)."""

    outputs: NDArray[np.float64]
    trip: Trip | None


def prepare(config: RigConfig) -> ControlSettings:
    """Convert a rig to settings in SI, once per run."""
    return ControlSettings(
        period_s=1.0 / config.control.rate_hz,
        armed_output=tuple(SafeOutputs.of(config.valves).held.tolist()),
        closed_output=tuple(valve.closed_output for valve in config.valves),
        valves=tuple(valve.regulator(config.limits, config.control) for valve in config.valves),
        valve_of=config.valve_of,
        limits=evaluation.settings(config),
        tracking_s=config.limits.tracking_s,
    )


def initial(settings: ControlSettings) -> ControlState:
    """The state before the first sample."""
    return ControlState(None, (RegulatorState(),) * len(settings.valves), (SensorState(),) * len(settings.valve_of))


def step(
    settings: ControlSettings,
    state: ControlState,
    sample: Sample,
    setpoint_pa: NDArray[np.float64],
    rate_pa_s: NDArray[np.float64],
) -> tuple[ControlState, ControlOutput]:
    """Return the outputs, or a trip, for a sample, the set-points (N,) [Pa] and their rates of change (N,) [Pa/s].

    Without a new scan the valves keep their outputs for three periods of the bench's time; then flow-metering valves
    are closed, and finally the samples count as stale. After a stall of this program each reference restarts at the
    measured pressure and returns to the set-point within the rate limit.
    """
    if state.trip is None:
        state = _step(settings, state, sample, setpoint_pa.tolist(), rate_pa_s.tolist())
    if state.trip is not None:
        return state, ControlOutput(np.empty(0), state.trip)
    # While the time of a simulated bench is stopped there are no new scans. Valves that are closed for that would be
    # closed in all the time that is simulated.
    bench_t_ns = sample.t_ns - sample.late_ns
    unmeasured = bench_t_ns - sample.scan_t_ns > UNMEASURED_PERIODS * settings.period_s * 1e9
    outputs = []
    for valve, armed, closed in zip(state.valves, settings.armed_output, settings.closed_output, strict=True):
        output = armed if math.isnan(valve.output) else valve.output
        outputs.append(closed if unmeasured and closed is not None else output)
    return state, ControlOutput(np.array(outputs), None)


def _step(
    settings: ControlSettings, state: ControlState, sample: Sample, setpoint: list[float], rate: list[float]
) -> ControlState:
    before, limits, pressure = state, settings.limits, sample.pressure_pa.tolist()
    new = sample.scan_t_ns != state.scan_t_ns
    passed = settings.period_s if state.scan_t_ns is None else (sample.scan_t_ns - state.scan_t_ns) * 1e-9
    dt = min(max(passed, SHORTEST_STEP_PERIODS * settings.period_s), LONGEST_STEP_PERIODS * settings.period_s)
    timers = max(dt, passed)
    if sample.stalled_ns and passed >= LONGEST_STEP_PERIODS * settings.period_s:
        state = _restart_references(settings, state, sample.t_ns, pressure, every_time=sample.time_stopped)
        timers = dt if sample.time_stopped else timers
    demands = []
    for i, valve_index in enumerate(settings.valve_of):
        valve = state.valves[valve_index]
        reference = pressure[i] if math.isnan(valve.reference_pa) else valve.reference_pa
        demands.append(RegulatorDemand(setpoint[i], reference, valve.demand_pa_s, valve.integral_pa_s))
    sensors, trip = evaluation.evaluate(
        limits, state.sensors, sample, demands, max(dt, passed), new=new, timers_s=timers
    )
    if trip is not None or not new:
        return before._replace(trip=trip)
    valves = []
    for s, valve in zip(settings.valves, state.valves, strict=True):
        # Several chambers on one valve share the air: the valve controls their mean.
        n = len(s.actuators)
        mean = sum(pressure[a] for a in s.actuators) / n
        target = sum(setpoint[a] for a in s.actuators) / n
        slope = sum(rate[a] for a in s.actuators) / n
        valves.append(regulate(s, valve, dt, mean, target, slope))
    return ControlState(sample.scan_t_ns, tuple(valves), sensors, None, state.restarted_ns)


def regulate(
    s: Regulator, state: RegulatorState, dt_s: float, measured_pa: float, setpoint_pa: float, rate_pa_s: float
) -> RegulatorState:
    """The state of one valve after `dt_s`: its type has the law from the reference to the output (`rig.valves`)."""
    before = state.reference_pa
    if math.isnan(before):
        before = max(measured_pa, s.lowest_pa)
    reference = reference_pa(s, before, setpoint_pa, rate_pa_s, dt_s)
    return s.command(state.integral_pa_s, dt_s, measured_pa, reference, (reference - before) / dt_s)


def _restart_references(
    settings: ControlSettings, state: ControlState, t_ns: int, pressure: list[float], *, every_time: bool
) -> ControlState:
    """Restart the references at the measured pressures after a stall.

    The timers of the interlocks are reset, too, but not again within twice the tracking time, so that a machine that
    stalls repeatedly still trips. With `every_time` (the time of the simulation stopped, too) they are always reset.
    """
    state = state._replace(valves=tuple(valve._replace(reference_pa=math.nan) for valve in state.valves))
    since_s = math.inf if state.restarted_ns is None else (t_ns - state.restarted_ns) * 1e-9
    if not every_time and RESTART_S < since_s < 2 * settings.tracking_s:
        return state
    sensors = tuple(sensor_state.reset(sensor, pa) for sensor, pa in zip(state.sensors, pressure, strict=True))
    return state._replace(sensors=sensors, restarted_ns=t_ns if since_s > RESTART_S else state.restarted_ns)
