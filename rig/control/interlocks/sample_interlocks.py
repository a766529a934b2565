"""Interlocks of one sample: emergency stops, old scans, a silent program, broken sensors."""

from __future__ import annotations

from rig.config.schema import RigConfig
from rig.control import sensor_state
from rig.control.interlocks.base import Sample, SampleInterlock, Trip


class EmergencyStops(SampleInterlock):
    """The contact of an emergency stop is open: it is pressed, or its wire is broken."""

    def __init__(self, config: RigConfig) -> None:
        super().__init__(config)
        self._names = tuple(config.emergency_stops)

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        for name, closed in zip(self._names, sample.stops_closed, strict=True):
            if not closed:
                message = f"emergency stop '{name}': its contact is open (pressed, or a wire is broken)"
                return Trip(sample.t_ns, f"emergency stop {name}", message, 0.0, 1.0, "closed", vent=True)
        return None


class StaleSamples(SampleInterlock):
    """The newest scan is older than `stale_s`.

    The duration of a stall of the whole computer (its host took the processor away) does not count, so that the scans
    of the stall can be read first.
    """

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        stale_s = self.limits.stale_s
        age_s = (sample.t_ns - sample.scan_t_ns) * 1e-9
        if age_s - sample.stalled_ns * 1e-9 <= stale_s:
            return None
        limit = f"(limit {stale_s * 1e3:.0f} ms)"
        message = (
            f"no pressure sample for {age_s * 1e3:.0f} ms {limit}" if sample.scan_t_ns else "no pressure sample yet"
        )
        return Trip(sample.t_ns, "stale samples", message, age_s, stale_s, "s")


class SilentStream(SampleInterlock):
    """Another program sends the set-points, and none has come for the time that the step of the protocol allows.

    The duration of a stall of this computer does not count, as for `StaleSamples`.
    """

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        stream = sample.stream
        if stream is None or stream.silent_s - sample.stalled_ns * 1e-9 <= stream.limit_s:
            return None
        key = "connect_s" if stream.first else "timeout_s"
        what = "no program has sent a set-point" if stream.first else f"no set-point after number {stream.sequence}"
        message = f"{what} for {stream.silent_s:.2f} s (limit {stream.limit_s:g} s: {key} of line {stream.line})"
        return Trip(sample.t_ns, "stream", message, stream.silent_s, stream.limit_s, "s")


class BrokenSensors(SampleInterlock):
    """A value is not a pressure: outside the span of its sensor, or at the end of the input's range."""

    def __init__(self, config: RigConfig) -> None:
        super().__init__(config)
        self._spans = []
        """Lowest and highest value of each sensor, the value of a saturated input, and their unit."""
        for sensor in config.sensors_by_actuator:
            low, high = sorted(sensor.signal_span)
            margin, ceiling = sensor.signal_margin, sensor.signal_range[1] - sensor_state.resolution(sensor)
            self._spans.append((low - margin, high + margin, ceiling, sensor.unit))

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        if not new:
            return None
        for number, (span, signal) in enumerate(zip(self._spans, sample.signals.tolist(), strict=True), 1):
            low, high, ceiling, unit = span
            if low <= signal <= high and signal < ceiling:
                continue
            limit = low if signal < low else min(high, ceiling)
            message = (
                f"sensor {number} reads {signal:.3f} {unit}, outside its span of {low:.2f} to "
                f"{min(high, ceiling):.2f} {unit}: sensor or wire broken"
            )
            return Trip(sample.t_ns, f"sensor {number}", message, signal, limit, unit)
        return None
