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

    lsb_v: float
    accuracy_pa: float
    tracking_pa: float
    lowest_pa: float = 0.0


class SensorState(NamedTuple):
    """State of one actuator's interlocks after a step; a named tuple for speed, six per cycle.

    `anchor_*`: since the last change of the reading by at least one count; `expected_pa` is the pressure change that
    the valve should have caused since. `left_*`: since the last change by more than noise.
    """

    pressure_pa: float = math.nan
    rate_pa_s: float = 0.0
    anchor_v: float = math.nan
    anchor_s: float = 0.0
    anchor_integral_pa_s: float = 0.0
    expected_pa: float = 0.0
    left_pa: float = math.nan
    left_reference_pa: float = math.nan
    left_s: float = 0.0
    setpoint_pa: float = math.nan
    still_s: float = 0.0
    off_reference_s: float = 0.0


class RegulatorDemand(NamedTuple):
    """The demand of one actuator's regulator: see `rig.valves.base.RegulatorState`."""

    setpoint_pa: float
    reference_pa: float
    rate_pa_s: float
    integral_pa_s: float


def lsb_v(sensor: Sensor) -> float:
    """One count of the 16-bit input of a sensor, in the unit of the input."""
    return (sensor.signal_range[1] - sensor.signal_range[0]) / SIXTEEN_BITS


def started(watch: SensorState, volts: float, pressure_pa: float, demand: RegulatorDemand) -> SensorState:
    """The state; the initial one at the first scan."""
    if not math.isnan(watch.pressure_pa):
        return watch
    return SensorState(
        pressure_pa=pressure_pa,
        anchor_v=volts,
        left_pa=pressure_pa,
        left_reference_pa=demand.reference_pa,
        setpoint_pa=demand.setpoint_pa,
    )


def updated(
    s: SensorSettings,
    watch: SensorState,
    dt: float,
    volts: float,
    pressure: float,
    demand: RegulatorDemand,
    counted: float,
) -> SensorState:
    """The state after a scan `dt` after the last one; `counted` is the part of `dt` that counts for the timers."""
    slope = (pressure - watch.pressure_pa) / dt
    rate = watch.rate_pa_s + (slope - watch.rate_pa_s) * dt / (RATE_FILTER_S + dt)
    if abs(volts - watch.anchor_v) >= s.lsb_v:
        anchor, still, expected, held = volts, 0.0, 0.0, demand.integral_pa_s
    else:
        anchor, still, held = watch.anchor_v, watch.anchor_s + counted, watch.anchor_integral_pa_s
        # A chamber cannot be emptied below the lowest pressure, whatever the valve does.
        expected = max(watch.expected_pa + (demand.rate_pa_s - held) * counted, -max(pressure - s.lowest_pa, 0.0))
    left, left_reference, left_s = watch.left_pa, watch.left_reference_pa, watch.left_s + counted
    if abs(pressure - left) > NOISE_SHARE * s.accuracy_pa:
        left, left_reference, left_s = pressure, demand.reference_pa, 0.0
    settled = demand.setpoint_pa == watch.setpoint_pa
    off_reference = abs(demand.reference_pa - pressure) > s.tracking_pa
    # Positional, because keyword arguments would double the time of this function.
    return SensorState(
        pressure,
        rate,
        anchor,
        still,
        held,
        expected,
        left,
        left_reference,
        left_s,
        demand.setpoint_pa,
        watch.still_s + counted if settled else 0.0,
        watch.off_reference_s + counted if off_reference else 0.0,
    )


def reset(watch: SensorState, pressure_pa: float) -> SensorState:
    """Restart the tracking timers after a stall without control; the pressure and its rate are kept."""
    return watch._replace(
        left_pa=pressure_pa, left_reference_pa=pressure_pa, left_s=0.0, still_s=0.0, off_reference_s=0.0
    )
