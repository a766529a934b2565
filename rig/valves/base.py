"""What a valve type provides: a section of the rig file, outputs, a regulator and a description for the simulator.

`rig.valves.registry` registers the types.
"""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from model.units import PA_PER_BAR
from protocols.validation import ValidationFault
from rig.sections.base import Section
from rig.sections.control import Control, Limits
from rig.sections.quantities import ActuatorNumber, Index, NonNegative, Number, VoltSpan, Word
from rig.valves.iso6358 import ATMOSPHERE_PA

REFERENCE_SHARE = 0.5
"""Bandwidth of the set-point filter as a share of the loop's: it is slower than the disturbance rejection."""

ValidationFaults = Iterator[ValidationFault]


class RegulatorState(NamedTuple):
    """State of one regulator after a step; `output` is what to write, in the unit of the valve.

    `reference_pa` is the set-point after the rate limit, `demand_pa_s` the rate of pressure change that the output
    should cause, `integral_pa_s` its part that compensates leakage. `reference_pa` is NaN before the first
    step, which starts it at the measured pressure.
    """

    reference_pa: float = math.nan
    integral_pa_s: float = 0.0
    demand_pa_s: float = 0.0
    output: float = math.nan


@dataclass(frozen=True)
class Regulator(ABC):
    """Settings of one valve's regulator in SI.

    Indices (from 0) of its actuators, lowest set-point (gauge), rate limit and set-point filter.
    """

    actuators: tuple[int, ...]
    lowest_pa: float
    rate_limit_pa_s: float
    filter_per_s: float

    @abstractmethod
    def command(
        self, integral_pa_s: float, dt_s: float, measured_pa: float, reference_pa: float, reference_rate_pa_s: float
    ) -> RegulatorState:
        """The state after a step of `dt_s` towards a filtered set-point; gauge pressures [Pa]."""


@dataclass(frozen=True)
class ValveTruth:
    """One simulated valve: a metered path, or an own regulator of the pressure.

    A metered path has the share `curve_fraction` of the sonic `conductance` [m3/(s Pa)] open at the distance `curve_v`
    from `closed_v`, to the supply at `supply_pa` (absolute) in the direction of `fill_sign`, else to the exhaust;
    `leak` is the conductance of the closed valve. With `pa_per_unit` other than 0 the valve holds the absolute pressure
    `pa_at_zero + pa_per_unit * output` by itself, between `lowest_pa` and `highest_pa`, those of its supplies.
    The spool follows the voltage within `half_hysteresis_v`.
    """

    closed_v: float = 0.0
    fill_sign: float = 1.0
    half_hysteresis_v: float = 0.0
    curve_v: tuple[float, ...] = ()
    curve_fraction: tuple[float, ...] = ()
    conductance: float = 0.0
    leak: float = 0.0
    supply_pa: float = ATMOSPHERE_PA
    critical_ratio: float = 0.3
    pa_at_zero: float = 0.0
    pa_per_unit: float = 0.0
    lowest_pa: float = ATMOSPHERE_PA
    highest_pa: float = math.inf


class SimulatedValve(Section):
    """True parameters of every valve. `spool_*` apply to all types, the others to flow-metering valves."""

    spool_hz: Number = Field(ge=0.1, le=1_000)
    spool_damping: Number = Field(default=0.7, ge=0.01, le=100)
    hysteresis_percent: NonNegative = Field(default=0.4, le=20)
    leakage_l_min: NonNegative
    dead_zone_V: NonNegative
    flow_scale: Number = Field(default=1.0, ge=0.1, le=10)


class ValveSection(Section, ABC):
    """One valve of the rig file: the keys and methods that every type has. A type adds `type` and keys of its own."""

    output_unit: ClassVar[str] = "V"
    """Unit of what the card's output takes; the outputs of every method are in it."""
    type: str
    actuators: Annotated[tuple[ActuatorNumber, ...], Field(min_length=1)]
    card: Word
    channel: Index
    safe_state: Literal["vent", "hold"] = "vent"

    @property
    @abstractmethod
    def output_range(self) -> tuple[float, float]:
        """Range of the card's output, in its unit."""

    @property
    @abstractmethod
    def vent_output(self) -> float:
        """The output that vents the chambers."""

    @property
    def vented_pa(self) -> float:
        """The gauge pressure of a vented chamber."""
        return 0.0

    @property
    def closed_output(self) -> float | None:
        """The output that stops the flow when control has no sample; None if the valve keeps its output then."""
        return None

    @property
    def fills_at_power_up(self) -> bool:
        """True if 0 V, the voltage of an attached card, fills the chambers."""
        return False

    @abstractmethod
    def regulator(self, limits: Limits, control: Control) -> Regulator:
        """The regulator of this valve."""

    @abstractmethod
    def simulated(self, truth: SimulatedValve) -> ValveTruth:
        """This valve in the simulator."""

    def faults(self) -> ValidationFaults:
        """Faults between the keys of this section; paths start at the section."""
        yield from ()

    def reach_faults(self, limits: Limits) -> ValidationFaults:
        """Faults that keep the valve from reaching the limits of the pressure (gauge); paths start at the section."""
        yield from ()

    def simulated_faults(self, truth: SimulatedValve) -> ValidationFaults:
        """True parameters that this valve cannot have; paths start at the parameters."""
        yield from ()

    def filter_settings(self, limits: Limits, control: Control) -> tuple[tuple[int, ...], float, float, float]:
        """The fields that every regulator has."""
        filter_per_s = REFERENCE_SHARE * 2 * math.pi * control.bandwidth_hz
        lowest_pa = limits.lowest_pressure_bar * PA_PER_BAR
        return tuple(a - 1 for a in self.actuators), lowest_pa, limits.rate_bar_per_s * PA_PER_BAR, filter_per_s


class VoltageValve(ValveSection):
    """A valve that a voltage commands."""

    range_V: VoltSpan = (0.0, 10.0)

    @property
    def output_range(self) -> tuple[float, float]:
        return self.range_V
