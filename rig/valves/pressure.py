"""Valves that hold the pressure by themselves: the set-point is a voltage, or a number on a bus."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from model.units import PA_PER_BAR
from protocols.validation import ValidationFault
from rig.sections.control import Control, Limits
from rig.sections.quantities import Bar, BarSpan, Number, VoltSpan
from rig.valves.base import (
    Regulator,
    RegulatorState,
    SimulatedValve,
    ValidationFaults,
    ValveSection,
    ValveTruth,
    VoltageValve,
)
from rig.valves.iso6358 import ATMOSPHERE_PA


@dataclass(frozen=True)
class PressureRegulator(Regulator):
    """Maps `low_pa` to `high_pa` (gauge) linearly to `low_output` to `high_output`, in the unit of the valve."""

    low_pa: float
    high_pa: float
    low_output: float
    high_output: float

    def command(
        self, integral_pa_s: float, dt_s: float, measured_pa: float, reference_pa: float, reference_rate_pa_s: float
    ) -> RegulatorState:
        """The output of the set-point; no feedback."""
        fraction = (reference_pa - self.low_pa) / (self.high_pa - self.low_pa)
        output = self.low_output + min(max(fraction, 0.0), 1.0) * (self.high_output - self.low_output)
        return RegulatorState(reference_pa, 0.0, reference_rate_pa_s, output)


class SetPointSpan(NamedTuple):
    """The range of set-points of a valve: gauge pressures, by their `key` in the section, and the outputs for them."""

    key: str
    bar: tuple[float, float]
    outputs: tuple[float, float]


class RegulatingValve(ValveSection):
    """A valve that holds the pressure by itself, between those of its two supplies."""

    supply_bar: Bar | SkipJsonSchema[None] = Field(
        default=None, description="gauge pressure at the supply port; default: high enough for the limits"
    )
    vacuum_bar: Number = Field(
        default=0.0, ge=-1, le=0, description="gauge pressure of the vacuum supply; 0: the exhaust is the atmosphere"
    )

    @property
    @abstractmethod
    def setpoints(self) -> SetPointSpan:
        """The pressures that the valve can hold."""

    def regulator(self, limits: Limits, control: Control) -> PressureRegulator:
        """The conversion of the set-point to an output."""
        _, (low_bar, high_bar), outputs = self.setpoints
        return PressureRegulator(
            *self.filter_settings(limits, control), low_bar * PA_PER_BAR, high_bar * PA_PER_BAR, *outputs
        )

    def simulated(self, truth: SimulatedValve) -> ValveTruth:
        """A valve that holds the set-point, within the pressures of its supplies."""
        _, (low_bar, high_bar), (low, high) = self.setpoints
        pa_per_unit = (high_bar - low_bar) / (high - low) * PA_PER_BAR
        return ValveTruth(
            pa_at_zero=low_bar * PA_PER_BAR - low * pa_per_unit + ATMOSPHERE_PA,
            pa_per_unit=pa_per_unit,
            lowest_pa=self.vacuum_bar * PA_PER_BAR + ATMOSPHERE_PA,
            highest_pa=math.inf if self.supply_bar is None else self.supply_bar * PA_PER_BAR + ATMOSPHERE_PA,
        )

    def reach_faults(self, limits: Limits) -> ValidationFaults:
        """Set-points that do not include the permitted pressures, and supplies that do not reach them."""
        key, (low_bar, high_bar), _ = self.setpoints
        lowest = f"limits, lowest_pressure_bar ({limits.lowest_pressure_bar:g} bar)"
        highest = f"limits, pressure_bar ({limits.pressure_bar:g} bar)"
        if not low_bar <= limits.lowest_pressure_bar < limits.pressure_bar <= high_bar:
            begin = lowest if limits.lowest_pressure_bar < 0 else "0"
            yield ValidationFault((key,), f"a range from {begin} to {highest} at least")
        if self.supply_bar is not None and self.supply_bar <= limits.pressure_bar:
            yield ValidationFault(("supply_bar",), f"more than {highest}: the valve cannot fill that far")
        if limits.lowest_pressure_bar < self.vacuum_bar:
            yield ValidationFault(("vacuum_bar",), f"at most {lowest}: the vacuum supply")


class PressureValve(VoltageValve, RegulatingValve):
    """An electro-pneumatic regulator that takes a set-point voltage and holds the pressure by itself."""

    type: Literal["pressure"]
    span_V: VoltSpan = (0.0, 10.0)
    span_bar: BarSpan

    @property
    def setpoints(self) -> SetPointSpan:
        return SetPointSpan("span_bar", self.span_bar, self.span_V)

    @property
    def vent_output(self) -> float:
        """The voltage of 0 bar, or the end of the span that is nearest to it."""
        _, (low_bar, high_bar), (low_v, high_v) = self.setpoints
        zero = low_v - low_bar * (high_v - low_v) / (high_bar - low_bar)
        return min(max(zero, min(low_v, high_v)), max(low_v, high_v))

    def faults(self) -> ValidationFaults:
        """A span outside the range of the output."""
        low, high = self.range_V
        if self.span_V[0] < low or self.span_V[1] > high:
            yield ValidationFault(("span_V",), f"a span inside range_V, {low:g} to {high:g} V")


class BusValve(RegulatingValve):
    """A pressure regulator that takes its set-point as a number, over a bus.

    `vent_bar` is the gauge pressure of its exhaust, which need not be the bottom of the range: with a vacuum supply the
    range begins below it.
    """

    output_unit: ClassVar[str] = "bar"
    type: Literal["bus"]
    range_bar: BarSpan
    vent_bar: Number = Field(default=0.0, ge=-1, le=1)

    @property
    def output_range(self) -> tuple[float, float]:
        return self.range_bar

    @property
    def setpoints(self) -> SetPointSpan:
        return SetPointSpan("range_bar", self.range_bar, self.range_bar)

    @property
    def vent_output(self) -> float:
        return self.vent_bar

    @property
    def vented_pa(self) -> float:
        """The gauge pressure of the exhaust."""
        return self.vent_bar * PA_PER_BAR

    def faults(self) -> ValidationFaults:
        """A vent level outside the range."""
        low, high = self.range_bar
        if not low <= self.vent_bar <= high:
            yield ValidationFault(("vent_bar",), f"a pressure inside range_bar, {low:g} to {high:g} bar")
