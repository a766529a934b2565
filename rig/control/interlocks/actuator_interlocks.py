"""Interlocks of one actuator: its pressure, the rate of the pressure, and a sensor that does not answer the valve."""

from __future__ import annotations

from model.units import PA_PER_BAR
from rig.config.schema import RigConfig
from rig.config.sections import Sensor
from rig.control.interlocks.base import ActuatorInterlock, Trip
from rig.control.sensor_state import RegulatorDemand, SensorState

FROZEN_FACTOR = 2.0
"""A constant reading counts as frozen once the valve should have moved it by this multiple of the accuracy."""


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

    def __init__(self, config: RigConfig, sensor: Sensor) -> None:
        super().__init__(config, sensor)
        self.frozen_s, self.accuracy_pa = self.limits.frozen_s, sensor.accuracy_bar * PA_PER_BAR

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        expected = abs(state.expected_change_pa)
        if not (state.unchanged_s >= self.frozen_s and expected > FROZEN_FACTOR * self.accuracy_pa):
            return None
        name = f"sensor {self.actuator}"
        message = (
            f"{name} has not moved by one count for {state.unchanged_s:.3f} s (limit {self.frozen_s:.3f} s) while its "
            f"valve should have changed it by {expected / PA_PER_BAR:.3f} bar: the sensor is frozen, or there is no air"
        )
        return Trip(t_ns, name, message, state.unchanged_s, self.frozen_s, "s")


class UnresponsiveSensor(ActuatorInterlock):
    """The reading moves by noise only while the reference leads it away."""

    def __init__(self, config: RigConfig, sensor: Sensor) -> None:
        super().__init__(config, sensor)
        self.tracking_pa = self.limits.tracking_bar * PA_PER_BAR
        valve = next(valve for valve in config.valves if sensor.actuator in valve.actuators)
        # How long the pressure may take to follow: a flow-metering valve would meanwhile continue to fill.
        self.response_s = 0.0 if valve.closed_output is not None else self.limits.frozen_s

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        reference_change = demand.reference_pa - state.moved_reference_pa
        if not (abs(reference_change) > self.tracking_pa and state.unmoved_s > self.response_s):
            return None
        name = f"sensor {self.actuator}"
        message = (
            f"{name} stays at {state.pressure_pa / PA_PER_BAR:.3f} bar: frozen, or no air, while its reference moved by"
        )
        return _trip_bar(t_ns, name, message, reference_change, self.tracking_pa)


class Tracking(ActuatorInterlock):
    """The pressure is off its standing set-point, or strays from its moving one, for `tracking_s`."""

    def __init__(self, config: RigConfig, sensor: Sensor) -> None:
        super().__init__(config, sensor)
        self.tracking_pa, self.tracking_s = self.limits.tracking_bar * PA_PER_BAR, self.limits.tracking_s

    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        name, error = f"actuator {self.actuator}", state.pressure_pa - demand.setpoint_pa
        if state.settled_s >= self.tracking_s and abs(error) > self.tracking_pa:
            return _trip_bar(t_ns, "tracking", f"{name} is off its standing set-point by", error, self.tracking_pa)
        if state.off_reference_s >= self.tracking_s:
            error = state.pressure_pa - demand.reference_pa
            message = f"{name} has strayed from its moving set-point for {state.off_reference_s:.2f} s, now by"
            return _trip_bar(t_ns, "tracking", message, error, self.tracking_pa)
        return None


def _trip_bar(t_ns: int, source: str, what: str, value: float, limit: float, unit: str = "bar") -> Trip:
    value, limit = value / PA_PER_BAR, limit / PA_PER_BAR
    return Trip(t_ns, source, f"{what} {value:.3f} {unit} (limit {limit:.3f} {unit})", value, limit, unit)
