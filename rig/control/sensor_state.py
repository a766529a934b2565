"""State of one pressure sensor between scans: what the interlocks of an actuator judge. Pure functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from rig.config.sections import Sensor

RATE_FILTER_S = 0.02
"""Time constant of the measured rate: shorter than a dangerous rise, longer than one noisy sample."""

SIXTEEN_BITS = 65_535

NOISE_SHARE = 0.5
"""A change of a reading below this share of the sensor's accuracy may be noise."""


@dataclass(frozen=True)
class SensorSettings:
    """What the state of one sensor depends on.

    One count of 16 bits, the accuracy, the largest tracking error, and the lowest pressure that its valve can reach.
    """

    resolution: float
    accuracy_pa: float
    tracking_pa: float
    lowest_pa: float = 0.0


class SensorState(NamedTuple):
    """State of one actuator's interlocks after a step; a named tuple for speed, six per cycle.

    `changed_*`, `unchanged_s`: last change of the reading by at least one count, and the time since; the valve should
    have changed the pressure by `expected_change_pa` since. `moved_*`, `unmoved_s`: last change by more than noise.
    `settled_s`: time since the last change of the set-point; `off_reference_s`: time with a tracking error.
    """

    pressure_pa: float = math.nan
    rate_pa_s: float = 0.0
    changed_signal: float = math.nan
    unchanged_s: float = 0.0
    changed_integral_pa_s: float = 0.0
    expected_change_pa: float = 0.0
    moved_pa: float = math.nan
    moved_reference_pa: float = math.nan
    unmoved_s: float = 0.0
    setpoint_pa: float = math.nan
    settled_s: float = 0.0
    off_reference_s: float = 0.0


class RegulatorDemand(NamedTuple):
    """The demand of one actuator's regulator: see `rig.valves.base.RegulatorState`."""

    setpoint_pa: float
    reference_pa: float
    rate_pa_s: float
    integral_pa_s: float


def resolution(sensor: Sensor) -> float:
    """One count of the 16-bit input of a sensor, in the unit of the input."""
    return (sensor.signal_range[1] - sensor.signal_range[0]) / SIXTEEN_BITS


def updated(
    settings: SensorSettings,
    state: SensorState,
    dt: float,
    signal: float,
    pressure: float,
    demand: RegulatorDemand,
    counted: float,
) -> SensorState:
    """The state after a scan `dt` after the last one; `counted` is the part of `dt` that counts for the timers."""
    if math.isnan(state.pressure_pa):
        state = SensorState(
            pressure_pa=pressure,
            changed_signal=signal,
            moved_pa=pressure,
            moved_reference_pa=demand.reference_pa,
            setpoint_pa=demand.setpoint_pa,
        )
    slope = (pressure - state.pressure_pa) / dt
    rate = state.rate_pa_s + (slope - state.rate_pa_s) * dt / (RATE_FILTER_S + dt)
    if abs(signal - state.changed_signal) >= settings.resolution:
        changed, unchanged, expected, integral = signal, 0.0, 0.0, demand.integral_pa_s
    else:
        changed, unchanged, integral = state.changed_signal, state.unchanged_s + counted, state.changed_integral_pa_s
        # No valve position can empty a chamber below the lowest pressure.
        expected = max(
            state.expected_change_pa + (demand.rate_pa_s - integral) * counted, -max(pressure - settings.lowest_pa, 0.0)
        )
    moved, moved_reference, unmoved_s = state.moved_pa, state.moved_reference_pa, state.unmoved_s + counted
    if abs(pressure - moved) > NOISE_SHARE * settings.accuracy_pa:
        moved, moved_reference, unmoved_s = pressure, demand.reference_pa, 0.0
    settled = demand.setpoint_pa == state.setpoint_pa
    off_reference = abs(demand.reference_pa - pressure) > settings.tracking_pa
    # Positional, because keyword arguments would double the time of this function.
    return SensorState(
        pressure,
        rate,
        changed,
        unchanged,
        integral,
        expected,
        moved,
        moved_reference,
        unmoved_s,
        demand.setpoint_pa,
        state.settled_s + counted if settled else 0.0,
        state.off_reference_s + counted if off_reference else 0.0,
    )


def reset(state: SensorState, pressure_pa: float) -> SensorState:
    """Restart the tracking timers after a stall without control; the pressure and its rate are kept."""
    return state._replace(
        moved_pa=pressure_pa, moved_reference_pa=pressure_pa, unmoved_s=0.0, settled_s=0.0, off_reference_s=0.0
    )
