"""Interlocks of one sample: emergency stops, old scans, a silent program, broken sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from rig.config.schema import RigConfig
from rig.control import sensor_state
from rig.control.interlocks.base import Sample, SampleInterlock, Trip


@dataclass(frozen=True)
class EmergencyStops(SampleInterlock):
    """The contact of an emergency stop is open: it is pressed, or its wire is broken."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, config: RigConfig) -> Self:
        return cls(tuple(config.emergency_stops))

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
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
        return cls(config.limits.stale_s)

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
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
        return cls()

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
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

    `spans` has the lowest and the highest value of each sensor, and the value of a saturated input, in its unit.
    """

    spans: tuple[tuple[float, float, float], ...]
    units: tuple[str, ...]

    @classmethod
    def of(cls, config: RigConfig) -> Self:
        """The electrical spans of the sensors, in the order of the actuators."""
        spans = []
        for sensor in config.sensors_by_actuator:
            low, high = sorted(sensor.signal_span)
            margin, ceiling = sensor.signal_margin, sensor.signal_range[1] - sensor_state.resolution(sensor)
            spans.append((low - margin, high + margin, ceiling))
        return cls(tuple(spans), tuple(sensor.unit for sensor in config.sensors_by_actuator))

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        for i, ((low, high, ceiling), signal) in enumerate(
            zip(self.spans, sample.signals.tolist() if new else (), strict=new)
        ):
            if low <= signal <= high and signal < ceiling:
                continue
            limit = low if signal < low else min(high, ceiling)
            message = (
                f"sensor {i + 1} reads {signal:.3f} {self.units[i]}, outside its span of {low:.2f} to "
                f"{min(high, ceiling):.2f} {self.units[i]}: sensor or wire broken"
            )
            return Trip(sample.t_ns, f"sensor {i + 1}", message, signal, limit, self.units[i])
        return None
