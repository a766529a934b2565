"""Interlocks, the conditions that stop a run: a pure step function of the sensor readings.

An interlock is an object with a limit; `SAMPLE_INTERLOCKS` and `ACTUATOR_INTERLOCKS` register them in the order in
which trips are reported. Each condition is explained in docs/explanation/control.md. Pressures are gauge; messages use
bar.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR, Sensor
from rig.control import sensor_state
from rig.control.sensor_state import RegulatorDemand, SensorSettings, SensorState

EVIDENCE = 2.0
"""A constant reading counts as frozen once the valve should have moved it by this multiple of the accuracy."""


class StreamSilence(NamedTuple):
    """For how long another program that sends the set-points has sent none.

    `first`: it has sent none since the step in this `line` of the protocol began. `sequence`: number of the last one.
    """

    silent_s: float
    limit_s: float
    first: bool
    line: int
    sequence: int


class Sample(NamedTuple):
    """Input of one control cycle.

    `t_ns` is the time of the cycle, `scan_t_ns` that of the newest scan (0 before the first); `volts` (N,) and
    `pressure_pa` (N,) come from the scans since the last cycle, or repeat the last values if there were none.
    `stops_closed` (E,): whether the contact of each emergency stop is closed now.
    `stalled_ns`: duration of a stall of this program just now, else 0. `time_stopped`: the bench is a simulation whose
    time stopped during the stall. `stream`: the silence of another program that sends the set-points.
    """

    t_ns: int
    scan_t_ns: int
    volts: NDArray[np.float64]
    pressure_pa: NDArray[np.float64]
    stalled_ns: int = 0
    time_stopped: bool = False
    stops_closed: tuple[bool, ...] = ()
    stream: StreamSilence | None = None


@dataclass(frozen=True)
class Trip:
    """The reason to stop a run. `value` and `limit` are in `unit`; the message contains all three.

    With `vent` the run ends with every chamber vented, also those that the safe state holds.
    """

    t_ns: int
    source: str
    message: str
    value: float
    limit: float
    unit: str
    vent: bool = False


class SampleInterlock(ABC):
    """A condition of one sample, checked before all conditions of the actuators."""

    @classmethod
    @abstractmethod
    def of(cls, config: RigConfig) -> Self:
        """The interlock with the limits of a rig."""

    @abstractmethod
    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        """The trip by a sample, None if the condition is not met; `new` is false if its scan was checked before."""


class ActuatorInterlock(ABC):
    """A condition of one actuator, checked for every new scan."""

    @classmethod
    @abstractmethod
    def of(cls, config: RigConfig, sensor: Sensor) -> Self:
        """The interlock with the limits of a rig, for the actuator of a sensor."""

    @abstractmethod
    def trip(self, t_ns: int, w: SensorState, demand: RegulatorDemand) -> Trip | None:
        """The trip by the state after a scan, None if the condition is not met."""


@dataclass(frozen=True)
class EmergencyStops(SampleInterlock):
    """The contact of an emergency stop is open: it is pressed, or its wire is broken."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, config: RigConfig) -> Self:
        """The stops of the rig file."""
        return cls(tuple(config.emergency_stops))

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        """Look for an open contact, also without a new scan."""
        for name, closed in zip(self.names, sample.stops_closed, strict=True):
            if not closed:
                message = f"emergency stop '{name}': its contact is open (pressed, or a wire is broken)"
                return Trip(sample.t_ns, f"emergency stop {name}", message, 0.0, 1.0, "closed", vent=True)
        return None


@dataclass(frozen=True)
class StaleSamples(SampleInterlock):
    """The newest scan is older than `stale_s`.

    The duration of a stall of the whole computer (its host took the processor away) does not count, so that the scans
    of the stall can be read first.
    """

    stale_s: float

    @classmethod
    def of(cls, config: RigConfig) -> Self:
        """The limit of the rig file."""
        return cls(config.limits.stale_s)

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        """Compare the age of the scan."""
        age_s = (sample.t_ns - sample.scan_t_ns) * 1e-9
        if age_s - sample.stalled_ns * 1e-9 <= self.stale_s:
            return None
        limit = f"(limit {self.stale_s * 1e3:.0f} ms)"
        message = (
            f"no pressure sample for {age_s * 1e3:.0f} ms {limit}" if sample.scan_t_ns else "no pressure sample yet"
        )
        return Trip(sample.t_ns, "stale samples", message, age_s, self.stale_s, "s")


@dataclass(frozen=True)
class SilentStream(SampleInterlock):
    """Another program sends the set-points, and none has come for the time that the step of the protocol allows.

    The duration of a stall of this computer does not count, as for `StaleSamples`.
    """

    @classmethod
    def of(cls, config: RigConfig) -> Self:
        """The limit is that of the step."""
        return cls()

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        """Compare the time since the last set-point."""
        stream = sample.stream
        if stream is None or stream.silent_s - sample.stalled_ns * 1e-9 <= stream.limit_s:
            return None
        key = "connect_s" if stream.first else "timeout_s"
        what = "no program has sent a set-point" if stream.first else f"no set-point after number {stream.sequence}"
        message = f"{what} for {stream.silent_s:.2f} s (limit {stream.limit_s:g} s: {key} of line {stream.line})"
        return Trip(sample.t_ns, "stream", message, stream.silent_s, stream.limit_s, "s")


@dataclass(frozen=True)
class BrokenSensors(SampleInterlock):
    """A value is not a pressure: outside the span of its sensor, or at the end of the input's range.

    `spans_v` has the lowest and the highest value of each sensor, and the value of a saturated input, in its unit.
    """

    spans_v: tuple[tuple[float, float, float], ...]
    units: tuple[str, ...]

    @classmethod
    def of(cls, config: RigConfig) -> Self:
        """The electrical spans of the sensors, in the order of the actuators."""
        spans = []
        for sensor in config.sensors_by_actuator:
            low, high = sorted(sensor.signal_span)
            margin, ceiling = sensor.signal_margin, sensor.signal_range[1] - sensor_state.count_v(sensor)
            spans.append((low - margin, high + margin, ceiling))
        return cls(tuple(spans), tuple(sensor.unit for sensor in config.sensors_by_actuator))

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        """Compare each voltage of a new scan."""
        for i, ((low, high, ceiling), volts) in enumerate(
            zip(self.spans_v, sample.volts.tolist() if new else (), strict=new)
        ):
            if low <= volts <= high and volts < ceiling:
                continue
            limit = low if volts < low else min(high, ceiling)
            message = (
                f"sensor {i + 1} reads {volts:.3f} {self.units[i]}, outside its span of {low:.2f} to "
                f"{min(high, ceiling):.2f} {self.units[i]}: sensor or wire broken"
            )
            return Trip(sample.t_ns, f"sensor {i + 1}", message, volts, limit, self.units[i])
        return None


@dataclass(frozen=True)
class OverPressure(ActuatorInterlock):
    """The pressure is above the limit with its margin, or not a number."""

    actuator: int
    limit_pa: float

    @classmethod
    def of(cls, config: RigConfig, sensor: Sensor) -> Self:
        """The limit of the rig file."""
        limits = config.limits
        return cls(sensor.actuator, (limits.pressure_bar + limits.pressure_margin_bar) * PA_PER_BAR)

    def trip(self, t_ns: int, w: SensorState, demand: RegulatorDemand) -> Trip | None:
        """Compare the pressure."""
        if w.pressure_pa <= self.limit_pa:
            return None
        return _trip_bar(t_ns, "over-pressure", f"actuator {self.actuator} is at", w.pressure_pa, self.limit_pa)


@dataclass(frozen=True)
class UnderPressure(ActuatorInterlock):
    """The pressure is below the lowest one with its margin."""

    actuator: int
    limit_pa: float

    @classmethod
    def of(cls, config: RigConfig, sensor: Sensor) -> Self:
        """The limit of the rig file."""
        limits = config.limits
        return cls(sensor.actuator, (limits.lowest_pressure_bar - limits.pressure_margin_bar) * PA_PER_BAR)

    def trip(self, t_ns: int, w: SensorState, demand: RegulatorDemand) -> Trip | None:
        """Compare the pressure."""
        if w.pressure_pa >= self.limit_pa:
            return None
        return _trip_bar(t_ns, "under-pressure", f"actuator {self.actuator} is at", w.pressure_pa, self.limit_pa)


@dataclass(frozen=True)
class PressureRate(ActuatorInterlock):
    """The filtered rate of the pressure is above the limit with its margin."""

    actuator: int
    limit_pa_s: float

    @classmethod
    def of(cls, config: RigConfig, sensor: Sensor) -> Self:
        """The limit of the rig file."""
        limits = config.limits
        return cls(sensor.actuator, (limits.rate_bar_per_s + limits.rate_margin_bar_per_s) * PA_PER_BAR)

    def trip(self, t_ns: int, w: SensorState, demand: RegulatorDemand) -> Trip | None:
        """Compare the rate."""
        if not abs(w.rate_pa_s) > self.limit_pa_s:
            return None
        what = f"actuator {self.actuator} changes by"
        return _trip_bar(t_ns, "pressure rate", what, w.rate_pa_s, self.limit_pa_s, "bar/s")


@dataclass(frozen=True)
class FrozenReading(ActuatorInterlock):
    """The reading has not moved by one count for `frozen_s` although the valve should have changed the pressure."""

    actuator: int
    frozen_s: float
    accuracy_pa: float

    @classmethod
    def of(cls, config: RigConfig, sensor: Sensor) -> Self:
        """The limit of the rig file."""
        return cls(sensor.actuator, config.limits.frozen_s, sensor.accuracy_bar * PA_PER_BAR)

    def trip(self, t_ns: int, w: SensorState, demand: RegulatorDemand) -> Trip | None:
        """Compare the time without a change, and the change that should have come."""
        expected = abs(w.expected_pa)
        if not (w.anchor_s >= self.frozen_s and expected > EVIDENCE * self.accuracy_pa):
            return None
        name = f"sensor {self.actuator}"
        message = (
            f"{name} has not moved by one count for {w.anchor_s:.3f} s (limit {self.frozen_s:.3f} s) while its "
            f"valve asked for {expected / PA_PER_BAR:.3f} bar: the sensor is frozen, or there is no air"
        )
        return Trip(t_ns, name, message, w.anchor_s, self.frozen_s, "s")


@dataclass(frozen=True)
class UnresponsiveSensor(ActuatorInterlock):
    """The reading moves by noise only while the reference leads it away.

    `response_s` is how long the pressure may take to follow a moving reference: zero if the sensor controls a
    flow-metering valve, which would otherwise continue to fill.
    """

    actuator: int
    tracking_pa: float
    response_s: float

    @classmethod
    def of(cls, config: RigConfig, sensor: Sensor) -> Self:
        """The limits of the rig file, by the valve's type."""
        valve = next(valve for valve in config.valves if sensor.actuator in valve.actuators)
        response_s = 0.0 if valve.closed_v is not None else config.limits.frozen_s
        return cls(sensor.actuator, config.limits.tracking_bar * PA_PER_BAR, response_s)

    def trip(self, t_ns: int, w: SensorState, demand: RegulatorDemand) -> Trip | None:
        """Compare the way of the reference since the reading last moved."""
        reference_change = demand.reference_pa - w.left_reference_pa
        if not (abs(reference_change) > self.tracking_pa and w.left_s > self.response_s):
            return None
        name = f"sensor {self.actuator}"
        message = (
            f"{name} stays at {w.pressure_pa / PA_PER_BAR:.3f} bar: frozen, or no air, while its reference moved by"
        )
        return _trip_bar(t_ns, name, message, reference_change, self.tracking_pa)


@dataclass(frozen=True)
class Tracking(ActuatorInterlock):
    """The pressure is off its standing set-point, or strays from its moving one, for `tracking_s`."""

    actuator: int
    tracking_pa: float
    tracking_s: float

    @classmethod
    def of(cls, config: RigConfig, sensor: Sensor) -> Self:
        """The limits of the rig file."""
        return cls(sensor.actuator, config.limits.tracking_bar * PA_PER_BAR, config.limits.tracking_s)

    def trip(self, t_ns: int, w: SensorState, demand: RegulatorDemand) -> Trip | None:
        """Compare the errors and how long they last."""
        name, error = f"actuator {self.actuator}", w.pressure_pa - demand.setpoint_pa
        if w.still_s >= self.tracking_s and abs(error) > self.tracking_pa:
            return _trip_bar(t_ns, "tracking", f"{name} is off its standing set-point by", error, self.tracking_pa)
        if w.off_reference_s >= self.tracking_s:
            error = w.pressure_pa - demand.reference_pa
            message = f"{name} has strayed from its moving set-point for {w.off_reference_s:.2f} s, now by"
            return _trip_bar(t_ns, "tracking", message, error, self.tracking_pa)
        return None


SAMPLE_INTERLOCKS: tuple[type[SampleInterlock], ...] = (EmergencyStops, StaleSamples, SilentStream, BrokenSensors)
ACTUATOR_INTERLOCKS: tuple[type[ActuatorInterlock], ...] = (
    OverPressure,
    UnderPressure,
    PressureRate,
    FrozenReading,
    UnresponsiveSensor,
    Tracking,
)


@dataclass(frozen=True)
class InterlockSettings:
    """The interlocks of a rig: those of a sample, and those of each actuator with the settings of its sensor."""

    sample: tuple[SampleInterlock, ...]
    sensors: tuple[SensorSettings, ...]
    actuators: tuple[tuple[ActuatorInterlock, ...], ...]


def settings(config: RigConfig) -> InterlockSettings:
    """The registered interlocks with the limits of a rig, sensors in the order of the actuators."""
    sensors = config.sensors_by_actuator
    tracking_pa, lowest_pa = config.limits.tracking_bar * PA_PER_BAR, config.limits.lowest_pressure_bar * PA_PER_BAR
    return InterlockSettings(
        sample=tuple(kind.of(config) for kind in SAMPLE_INTERLOCKS),
        sensors=tuple(
            SensorSettings(sensor_state.count_v(s), s.accuracy_bar * PA_PER_BAR, tracking_pa, lowest_pa)
            for s in sensors
        ),
        actuators=tuple(tuple(kind.of(config, s) for kind in ACTUATOR_INTERLOCKS) for s in sensors),
    )


def evaluate(
    s: InterlockSettings,
    states: tuple[SensorState, ...],
    sample: Sample,
    demands: Sequence[RegulatorDemand],
    dt_s: float,
    *,
    new: bool,
    counted_s: float | None = None,
) -> tuple[tuple[SensorState, ...], Trip | None]:
    """Check a sample; return the states after it and the first trip.

    `demands` (N,) are those on the valves since the last scan, `dt_s` before; without a `new` scan the states remain.
    `counted_s` is the part of `dt_s` that counts for the timers: all of it unless the time of a simulation stopped.
    """
    for interlock in s.sample:
        if trip := interlock.trip(sample, new=new):
            return states, trip
    if not new:
        return states, None
    counted_s = dt_s if counted_s is None else counted_s
    first: Trip | None = None
    moved = []
    readings = zip(states, sample.volts.tolist(), sample.pressure_pa.tolist(), demands, strict=True)
    for i, (state, volts, pressure_pa, demand) in enumerate(readings):
        after = sensor_state.updated(
            s.sensors[i],
            sensor_state.started(state, volts, pressure_pa, demand),
            dt_s,
            volts,
            pressure_pa,
            demand,
            counted_s,
        )
        moved.append(after)
        for condition in s.actuators[i]:
            first = first or condition.trip(sample.t_ns, after, demand)
    return tuple(moved), first


def _trip_bar(t_ns: int, source: str, what: str, value: float, limit: float, unit: str = "bar") -> Trip:
    value, limit = value / PA_PER_BAR, limit / PA_PER_BAR
    return Trip(t_ns, source, f"{what} {value:.3f} {unit} (limit {limit:.3f} {unit})", value, limit, unit)
