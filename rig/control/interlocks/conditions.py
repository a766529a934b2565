"""The interlocks, registered in `evaluation`: those of a sample, then those of the pressure of an actuator."""

from __future__ import annotations

from model.units import PA_PER_BAR
from rig.config.schema import RigConfig
from rig.config.sections import Sensor
from rig.control import sensor_state
from rig.control.interlocks.base import ActuatorInterlock, Sample, SampleInterlock, Trip
from rig.control.sensor_state import RegulatorDemand, SensorState

FROZEN_FACTOR = 2.0
"""A constant reading counts as frozen once the valve should have moved it by this multiple of the accuracy."""


class EmergencyStops(SampleInterlock):
    """The contact of an emergency stop is open: it is pressed, or its wire is broken."""

    def __init__(self, config: RigConfig) -> None:
        super().__init__(config)
        self._names = tuple(config.emergency_stops)

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        for name, closed in zip(self._names, sample.stops_closed, strict=True):
            if not closed:
                message = f"emergency stop '{name}': its contact is open (pressed, or a wire is broken)"
                return Trip(sample.t_ns, f"emergency stop {name}", message, vent=True)
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
        return Trip(sample.t_ns, "stale samples", message)


class SilentSource(SampleInterlock):
    """A source of the set-points has sent none for the time that the protocol or the rig allows.

    The duration of a stall of this computer does not count, as for `StaleSamples`.
    """

    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        for silence in sample.silences:
            if silence.silent_s - sample.stalled_ns * 1e-9 > silence.limit_s:
                limit = f"(limit {silence.limit_s:g} s: {silence.limit_key})"
                return Trip(sample.t_ns, silence.source, f"{silence.what} for {silence.silent_s:.2f} s {limit}")
        return None


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
            message = (
                f"sensor {number} reads {signal:.3f} {unit}, outside its span of {low:.2f} to "
                f"{min(high, ceiling):.2f} {unit}: sensor or wire broken"
            )
            return Trip(sample.t_ns, f"sensor {number}", message)
        return None


class PressureRange(ActuatorInterlock):
    """The pressure is outside the limits with their margin, or not a number."""

    def __init__(self, config: RigConfig, sensor: Sensor) -> None:
        super().__init__(config, sensor)
        margin_bar = self.limits.pressure_margin_bar
        self.lowest_pa = (self.limits.lowest_pressure_bar - margin_bar) * PA_PER_BAR
        self.highest_pa = (self.limits.pressure_bar + margin_bar) * PA_PER_BAR

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        if self.lowest_pa <= state.pressure_pa <= self.highest_pa:
            return None
        below = state.pressure_pa < self.lowest_pa
        source, limit_pa = ("under-pressure", self.lowest_pa) if below else ("over-pressure", self.highest_pa)
        return _trip_bar(t_ns, source, f"actuator {self.actuator} is at", state.pressure_pa, limit_pa)


class PressureRate(ActuatorInterlock):
    """The filtered rate of the pressure is above the limit with its margin."""

    def __init__(self, config: RigConfig, sensor: Sensor) -> None:
        super().__init__(config, sensor)
        self.limit_pa_s = (self.limits.rate_bar_per_s + self.limits.rate_margin_bar_per_s) * PA_PER_BAR

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        if not abs(state.rate_pa_s) > self.limit_pa_s:
            return None
        what = f"actuator {self.actuator} changes by"
        return _trip_bar(t_ns, "pressure rate", what, state.rate_pa_s, self.limit_pa_s, "bar/s")


class FrozenReading(ActuatorInterlock):
    """The reading has not moved by one count for `frozen_s` although the valve should have changed the pressure."""

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        expected, frozen_s = abs(state.expected_change_pa), self.limits.frozen_s
        if not (state.unchanged_s >= frozen_s and expected > FROZEN_FACTOR * self.accuracy_pa):
            return None
        name = f"sensor {self.actuator}"
        message = (
            f"{name} has not moved by one count for {state.unchanged_s:.3f} s (limit {frozen_s:.3f} s) while its "
            f"valve should have changed it by {expected / PA_PER_BAR:.3f} bar: the sensor is frozen, or there is no air"
        )
        return Trip(t_ns, name, message)


class UnresponsivePressure(ActuatorInterlock):
    """The reading moves by noise only while the reference leads it away: valve, air or sensor may be the cause."""

    def __init__(self, config: RigConfig, sensor: Sensor) -> None:
        super().__init__(config, sensor)
        valve = next(valve for valve in config.valves if sensor.actuator in valve.actuators)
        # How long the pressure may take to follow: a flow-metering valve would meanwhile continue to fill.
        self.response_s = 0.0 if valve.closed_output is not None else self.limits.frozen_s

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        reference_change = demand.reference_pa - state.moved_reference_pa
        if not (abs(reference_change) > self.tracking_pa and state.unmoved_s > self.response_s):
            return None
        name = f"actuator {self.actuator}"
        message = (
            f"{name} stays at {state.pressure_pa / PA_PER_BAR:.3f} bar: no air, too little flow through its valve, or "
            "a sensor that hangs, while its reference moved by"
        )
        return _trip_bar(t_ns, name, message, reference_change, self.tracking_pa)


class Tracking(ActuatorInterlock):
    """The pressure is off its standing set-point, or strays from its moving one, for `tracking_s`."""

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        name, error = f"actuator {self.actuator}", state.pressure_pa - demand.setpoint_pa
        if state.settled_s >= self.limits.tracking_s and abs(error) > self.tracking_pa:
            return _trip_bar(t_ns, "tracking", f"{name} is off its standing set-point by", error, self.tracking_pa)
        if state.off_reference_s >= self.limits.tracking_s:
            error = state.pressure_pa - demand.reference_pa
            message = f"{name} has strayed from its moving set-point for {state.off_reference_s:.2f} s, now by"
            return _trip_bar(t_ns, "tracking", message, error, self.tracking_pa)
        return None


def _trip_bar(t_ns: int, source: str, what: str, value: float, limit: float, unit: str = "bar") -> Trip:
    reached, permitted = f"{value / PA_PER_BAR:.3f} {unit}", f"{limit / PA_PER_BAR:.3f} {unit}"
    return Trip(t_ns, source, f"{what} {reached} (limit {permitted})")
