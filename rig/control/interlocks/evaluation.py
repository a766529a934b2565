"""Evaluation of the interlocks for each sample.

`SAMPLE_INTERLOCKS` and `ACTUATOR_INTERLOCKS` register the interlocks in the order in which trips are reported. Each
condition is explained in docs/explanation/control.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from model.units import PA_PER_BAR
from rig.config.schema import RigConfig
from rig.control import sensor_state
from rig.control.interlocks import conditions
from rig.control.interlocks.base import ActuatorInterlock, Sample, SampleInterlock, Trip
from rig.control.sensor_state import RegulatorDemand, SensorSettings, SensorState

SAMPLE_INTERLOCKS: tuple[type[SampleInterlock], ...] = (
    conditions.EmergencyStops,
    conditions.StaleSamples,
    conditions.SilentSource,
    conditions.BrokenSensors,
)
ACTUATOR_INTERLOCKS: tuple[type[ActuatorInterlock], ...] = (
    conditions.PressureRange,
    conditions.PressureRate,
    conditions.FrozenReading,
    conditions.UnresponsivePressure,
    conditions.Tracking,
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
        sample=tuple(kind(config) for kind in SAMPLE_INTERLOCKS),
        sensors=tuple(
            SensorSettings(sensor_state.resolution(s), s.accuracy_bar * PA_PER_BAR, tracking_pa, lowest_pa)
            for s in sensors
        ),
        actuators=tuple(tuple(kind(config, s) for kind in ACTUATOR_INTERLOCKS) for s in sensors),
    )


def evaluate(
    s: InterlockSettings,
    states: tuple[SensorState, ...],
    sample: Sample,
    demands: Sequence[RegulatorDemand],
    dt_s: float,
    *,
    new: bool,
    timers_s: float | None = None,
) -> tuple[tuple[SensorState, ...], Trip | None]:
    """Check a sample; return the states after it and the first trip.

    `demands` (N,) are those on the valves since the last scan, `dt_s` before; without a `new` scan the states remain.
    `timers_s` is the part of `dt_s` that counts for the timers: all of it unless the time of a simulation stopped.
    """
    for interlock in s.sample:
        if trip := interlock.trip(sample, new=new):
            return states, trip
    if not new:
        return states, None
    timers_s = dt_s if timers_s is None else timers_s
    first: Trip | None = None
    moved = []
    readings = zip(states, sample.signals.tolist(), sample.pressure_pa.tolist(), demands, strict=True)
    for i, (state, signal, pressure_pa, demand) in enumerate(readings):
        after = sensor_state.updated(s.sensors[i], state, dt_s, signal, pressure_pa, demand, timers_s)
        moved.append(after)
        for condition in s.actuators[i]:
            first = first or condition.trip(sample.t_ns, after, demand)
    return tuple(moved), first
