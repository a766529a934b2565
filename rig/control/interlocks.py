"""Interlocks, the conditions that stop a run: a pure step function of the sensor readings.

Each condition is explained in docs/explanation/control.md. Pressures are gauge; messages use bar.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR, Sensor

RATE_FILTER_S = 0.02
"""Time constant of the measured rate: shorter than a dangerous rise, longer than one noisy sample."""

SIXTEEN_BITS = 65_535

NOISE_SHARE = 0.5
"""A change of a reading below this share of the sensor's accuracy may be noise."""

EVIDENCE = 2.0
"""A constant reading counts as frozen once the valve should have moved it by this multiple of the accuracy."""


class Sample(NamedTuple):
    """Input of one control cycle.

    `t_ns` is the time of the cycle, `scan_t_ns` that of the newest scan (0 before the first); `volts` (N,) and
    `pressure_pa` (N,) come from the scans since the last cycle, or repeat the last values if there were none.
    `stalled_ns`: duration of a stall of this program just now, else 0. `time_stopped`: the bench is a simulation whose
    time stopped during the stall.
    """

    t_ns: int
    scan_t_ns: int
    volts: NDArray[np.float64]
    pressure_pa: NDArray[np.float64]
    stalled_ns: int = 0
    time_stopped: bool = False


@dataclass(frozen=True)
class Trip:
    """The reason to stop a run. `value` and `limit` are in `unit`; the message contains all three."""

    t_ns: int
    source: str
    message: str
    value: float
    limit: float
    unit: str


@dataclass(frozen=True)
class SensorSettings:
    """Limits of one sensor.

    `ceiling_v` is a saturated input, `count_v` one count of 16 bits. `response_s` is how long the pressure may take to
    follow a moving reference: zero if the sensor controls a flow-metering valve, which would otherwise continue to
    fill.
    """

    low_v: float
    high_v: float
    ceiling_v: float
    count_v: float
    accuracy_pa: float
    response_s: float


@dataclass(frozen=True)
class Settings:
    """The rig's limits in SI."""

    sensors: tuple[SensorSettings, ...]
    pressure_pa: float
    rate_pa_s: float
    tracking_pa: float
    tracking_s: float
    frozen_s: float
    stale_s: float


class SensorState(NamedTuple):
    """State of one actuator's interlocks after a step; a named tuple for speed, six per cycle.

    The anchor is the last reading that differed from the one before it by a count; `expected_pa` is the
    pressure change that the valve should have caused since. `left_*` belong to the last reading that differed from the
    one before it by more than noise.
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


class Demand(NamedTuple):
    """The demand of one actuator's regulator: see `rig.valves.base.RegulatorState`."""

    setpoint_pa: float
    reference_pa: float
    rate_pa_s: float
    integral_pa_s: float


def settings(config: RigConfig) -> Settings:
    """The rig's limits and sensors, in SI, sensors in the order of the actuators."""
    limits = config.limits
    sensors = sorted(config.sensors, key=lambda sensor: sensor.actuator)
    metered = {a for valve in config.valves if valve.closed_v is not None for a in valve.actuators}
    return Settings(
        sensors=tuple(_sensor(s, 0.0 if s.actuator in metered else limits.frozen_s) for s in sensors),
        pressure_pa=(limits.pressure_bar + limits.pressure_margin_bar) * PA_PER_BAR,
        rate_pa_s=(limits.rate_bar_per_s + limits.rate_margin_bar_per_s) * PA_PER_BAR,
        tracking_pa=limits.tracking_bar * PA_PER_BAR,
        tracking_s=limits.tracking_s,
        frozen_s=limits.frozen_s,
        stale_s=limits.stale_s,
    )


def _sensor(sensor: Sensor, response_s: float) -> SensorSettings:
    low, high = sorted(sensor.span_V)
    count = (sensor.range_V[1] - sensor.range_V[0]) / SIXTEEN_BITS
    return SensorSettings(
        low_v=low - sensor.margin_V,
        high_v=high + sensor.margin_V,
        ceiling_v=sensor.range_V[1] - count,
        count_v=count,
        accuracy_pa=sensor.accuracy_bar * PA_PER_BAR,
        response_s=response_s,
    )


def stale(s: Settings, sample: Sample) -> Trip | None:
    """Trip when the newest scan is older than the limit `stale_s`.

    The duration of a stall of the whole computer (its host took the processor away) does not count, so that the scans
    of the stall can be read first.
    """
    age_s = (sample.t_ns - sample.scan_t_ns) * 1e-9
    if age_s - sample.stalled_ns * 1e-9 <= s.stale_s:
        return None
    limit = f"(limit {s.stale_s * 1e3:.0f} ms)"
    message = f"no pressure sample for {age_s * 1e3:.0f} ms {limit}" if sample.scan_t_ns else "no pressure sample yet"
    return Trip(sample.t_ns, "stale samples", message, age_s, s.stale_s, "s")


def broken(s: Settings, sample: Sample) -> Trip | None:
    """Trip when a voltage is not a pressure: outside the sensor's span, or at the end of the card's range."""
    for i, (sensor, volts) in enumerate(zip(s.sensors, sample.volts.tolist(), strict=True)):
        if sensor.low_v <= volts <= sensor.high_v and volts < sensor.ceiling_v:
            continue
        limit = sensor.low_v if volts < sensor.low_v else min(sensor.high_v, sensor.ceiling_v)
        message = (
            f"sensor {i + 1} reads {volts:.3f} V, outside its span of {sensor.low_v:.2f} to "
            f"{min(sensor.high_v, sensor.ceiling_v):.2f} V: sensor or wire broken"
        )
        return Trip(sample.t_ns, f"sensor {i + 1}", message, volts, limit, "V")
    return None


def reset(watch: SensorState, pressure_pa: float) -> SensorState:
    """Restart the tracking timers after a stall without control; the pressure and its rate are kept."""
    return watch._replace(
        left_pa=pressure_pa, left_reference_pa=pressure_pa, left_s=0.0, still_s=0.0, off_reference_s=0.0
    )


def step(
    s: Settings,
    i: int,
    watch: SensorState,
    dt_s: float,
    t_ns: int,
    volts: float,
    pressure_pa: float,
    asked: Demand,
    counted_s: float | None = None,
) -> tuple[SensorState, Trip | None]:
    """Check a new reading of actuator `i`, `dt_s` after the last; `asked` is the demand on its valve in between.

    `counted_s` is the part of `dt_s` that counts for the timers: all of it unless the time of a simulation stopped.
    """
    if math.isnan(watch.pressure_pa):
        watch = SensorState(
            pressure_pa=pressure_pa,
            anchor_v=volts,
            left_pa=pressure_pa,
            left_reference_pa=asked.reference_pa,
            setpoint_pa=asked.setpoint_pa,
        )
    watch = _moved(s, i, watch, dt_s, volts, pressure_pa, asked, dt_s if counted_s is None else counted_s)
    return watch, _judge(s, i, watch, t_ns, asked)


def _moved(
    s: Settings, i: int, watch: SensorState, dt: float, volts: float, pressure: float, asked: Demand, counted: float
) -> SensorState:
    slope = (pressure - watch.pressure_pa) / dt
    rate = watch.rate_pa_s + (slope - watch.rate_pa_s) * dt / (RATE_FILTER_S + dt)
    if abs(volts - watch.anchor_v) >= s.sensors[i].count_v:
        anchor, still, expected, held = volts, 0.0, 0.0, asked.integral_pa_s
    else:
        anchor, still, held = watch.anchor_v, watch.anchor_s + counted, watch.anchor_integral_pa_s
        # A chamber cannot be emptied below the atmosphere, whatever the valve does.
        expected = max(watch.expected_pa + (asked.rate_pa_s - held) * counted, -max(pressure, 0.0))
    left, left_reference, left_s = watch.left_pa, watch.left_reference_pa, watch.left_s + counted
    if abs(pressure - left) > NOISE_SHARE * s.sensors[i].accuracy_pa:
        left, left_reference, left_s = pressure, asked.reference_pa, 0.0
    settled = asked.setpoint_pa == watch.setpoint_pa
    off_reference = abs(asked.reference_pa - pressure) > s.tracking_pa
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
        asked.setpoint_pa,
        watch.still_s + counted if settled else 0.0,
        watch.off_reference_s + counted if off_reference else 0.0,
    )


def _judge(s: Settings, i: int, w: SensorState, t_ns: int, asked: Demand) -> Trip | None:
    name = f"actuator {i + 1}"
    if not w.pressure_pa <= s.pressure_pa:
        return _trip_bar(t_ns, "over-pressure", f"{name} is at", w.pressure_pa, s.pressure_pa)
    if abs(w.rate_pa_s) > s.rate_pa_s:
        return _trip_bar(t_ns, "pressure rate", f"{name} changes by", w.rate_pa_s, s.rate_pa_s, "bar/s")
    sensor = s.sensors[i]
    expected = abs(w.expected_pa)
    if w.anchor_s >= s.frozen_s and expected > EVIDENCE * sensor.accuracy_pa:
        message = (
            f"sensor {i + 1} has not moved by one count for {w.anchor_s:.3f} s (limit {s.frozen_s:.3f} s) while its "
            f"valve asked for {expected / PA_PER_BAR:.3f} bar: the sensor is frozen, or there is no air"
        )
        return Trip(t_ns, f"sensor {i + 1}", message, w.anchor_s, s.frozen_s, "s")
    led = asked.reference_pa - w.left_reference_pa
    if abs(led) > s.tracking_pa and w.left_s > sensor.response_s:
        message = f"sensor {i + 1} stays at {w.pressure_pa / PA_PER_BAR:.3f} bar: frozen, or no air, though led by"
        return _trip_bar(t_ns, f"sensor {i + 1}", message, led, s.tracking_pa)
    error = w.pressure_pa - asked.setpoint_pa
    if w.still_s >= s.tracking_s and abs(error) > s.tracking_pa:
        return _trip_bar(t_ns, "tracking", f"{name} is off its standing set-point by", error, s.tracking_pa)
    if w.off_reference_s >= s.tracking_s:
        error = w.pressure_pa - asked.reference_pa
        message = f"{name} has strayed from its moving set-point for {w.off_reference_s:.2f} s, now by"
        return _trip_bar(t_ns, "tracking", message, error, s.tracking_pa)
    return None


def _trip_bar(t_ns: int, source: str, what: str, value: float, limit: float, unit: str = "bar") -> Trip:
    value, limit = value / PA_PER_BAR, limit / PA_PER_BAR
    return Trip(t_ns, source, f"{what} {value:.3f} {unit} (limit {limit:.3f} {unit})", value, limit, unit)
