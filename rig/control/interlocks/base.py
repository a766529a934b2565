"""Interfaces of the interlocks, their input and the trip that they return.

Pressures are gauge and in Pa; messages use bar.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from rig.config.schema import RigConfig
from rig.config.sections import Sensor
from rig.control.sensor_state import RegulatorDemand, SensorState


class Silence(NamedTuple):
    """For how long a source of the set-points, such as another program, has sent none.

    `source`: its name in the record. `what` has not come, and `limit_key` of rig or protocol states the limit.
    """

    source: str
    silent_s: float
    limit_s: float
    what: str
    limit_key: str


class Sample(NamedTuple):
    """Input of one control cycle.

    `t_ns` is the time of the cycle, `scan_t_ns` that of the newest scan (0 before the first); `signals` (N,) and
    `pressure_pa` (N,) come from the scans since the last cycle, or repeat the last values if there were none.
    `stops_closed` (E,): whether the contact of each emergency stop is closed now.
    `stalled_ns`: duration of a stall of this program just now, else 0. `time_stopped`: the bench is a simulation whose
    time stopped during the stall; `late_ns`: how far its time is behind `t_ns`, 0 for hardware. `silences`: those of
    the sources of the set-points.
    """

    t_ns: int
    scan_t_ns: int
    signals: NDArray[np.float64]
    pressure_pa: NDArray[np.float64]
    stalled_ns: int = 0
    time_stopped: bool = False
    late_ns: int = 0
    stops_closed: tuple[bool, ...] = ()
    silences: tuple[Silence, ...] = ()


@dataclass(frozen=True)
class Trip:
    """The reason to stop a run; the message has the value and its limit.

    With `vent` the run ends with every chamber vented, also those that the safe state holds.
    """

    t_ns: int
    source: str
    message: str
    vent: bool = False


class SampleInterlock(ABC):
    """A condition of one sample, checked before all conditions of the actuators."""

    def __init__(self, config: RigConfig) -> None:
        """Take the limits of a rig."""
        self.limits = config.limits

    @abstractmethod
    def trip(self, sample: Sample, *, new: bool) -> Trip | None:
        """The trip by a sample, None if the condition is not met; `new` is false if its scan was checked before."""


class ActuatorInterlock(ABC):
    """A condition of one actuator, checked for every new scan."""

    def __init__(self, config: RigConfig, sensor: Sensor) -> None:
        """Take the limits of a rig, for the actuator of a sensor."""
        self.limits, self.actuator = config.limits, sensor.actuator
        self.tracking_pa, self.accuracy_pa = config.limits.tracking_bar * PA_PER_BAR, sensor.accuracy_bar * PA_PER_BAR

    @abstractmethod
    def trip(self, t_ns: int, state: SensorState, demand: RegulatorDemand) -> Trip | None:
        """The trip by the state after a scan, None if the condition is not met."""
