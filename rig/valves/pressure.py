"""Valves that hold the pressure by themselves: the set-point is a voltage, or a number on a bus."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

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


class RegulatingValve(ValveSection):
    """A valve that holds the pressure by itself, between those of its two supplies."""

    supply_bar: Bar | SkipJsonSchema[None] = Field(
        default=None, description="gauge pressure at the supply port; default: high enough for the limits"
    )
    vacuum_bar: Number = Field(
        default=0.0, ge=-1, le=0, description="gauge pressure of the vacuum supply; 0: the exhaust is the atmosphere"
    )

    def supply_faults(self, limits: Limits) -> ValidationFaults:
        """Supplies that do not reach the limits of the pressure."""
        if self.supply_bar is not None and self.supply_bar <= limits.pressure_bar:
            expected = f"more than limits, pressure_bar ({limits.pressure_bar:g} bar): the valve cannot fill that far"
            yield ValidationFault(("supply_bar",), expected)
        if limits.lowest_pressure_bar < self.vacuum_bar:
            expected = f"at most limits, lowest_pressure_bar ({limits.lowest_pressure_bar:g} bar): the vacuum supply"
            yield ValidationFault(("vacuum_bar",), expected)

    def held(self, truth: ValveTruth) -> ValveTruth:
        """The simulated valve with the pressures of its supplies."""
        highest_pa = math.inf if self.supply_bar is None else self.supply_bar * PA_PER_BAR + ATMOSPHERE_PA
        return replace(truth, lowest_pa=self.vacuum_bar * PA_PER_BAR + ATMOSPHERE_PA, highest_pa=highest_pa)


def range_faults(key: str, span_bar: tuple[float, float], limits: Limits) -> ValidationFaults:
    """A range of set-points that does not include the permitted pressures; `key` is its place in the section."""
    if not span_bar[0] <= limits.lowest_pressure_bar < limits.pressure_bar <= span_bar[1]:
        lowest = "0"
        if limits.lowest_pressure_bar < 0:
            lowest = f"limits, lowest_pressure_bar ({limits.lowest_pressure_bar:g} bar)"
        expected = f"a range from {lowest} to limits, pressure_bar ({limits.pressure_bar:g} bar) at least"
        yield ValidationFault((key,), expected)


class PressureValve(VoltageValve, RegulatingValve):
    """An electro-pneumatic regulator that takes a set-point voltage and holds the pressure by itself."""

    type: Literal["pressure"]
    span_V: VoltSpan = (0.0, 10.0)
    span_bar: BarSpan

    @property
    def vent_output(self) -> float:
        """The voltage of 0 bar, or the end of the span that is nearest to it."""
        (low_v, high_v), (low_bar, high_bar) = self.span_V, self.span_bar
        zero = low_v - low_bar * (high_v - low_v) / (high_bar - low_bar)
        return min(max(zero, min(low_v, high_v)), max(low_v, high_v))

    def regulator(self, limits: Limits, control: Control) -> PressureRegulator:
        """The conversion of the set-point to a voltage."""
        (low_v, high_v), (low_bar, high_bar) = self.span_V, self.span_bar
        return PressureRegulator(
            *self._filter(limits, control), low_bar * PA_PER_BAR, high_bar * PA_PER_BAR, low_v, high_v
        )

    def simulated(self, truth: SimulatedValve) -> ValveTruth:
        (low_v, high_v), (low_bar, high_bar) = self.span_V, self.span_bar
        pa_per_unit = (high_bar - low_bar) / (high_v - low_v) * PA_PER_BAR
        pa_at_zero = low_bar * PA_PER_BAR - low_v * pa_per_unit + ATMOSPHERE_PA
        return self.held(ValveTruth(pa_at_zero=pa_at_zero, pa_per_unit=pa_per_unit))

    def faults(self) -> ValidationFaults:
        """A span outside the range of the output."""
        low, high = self.range_V
        if self.span_V[0] < low or self.span_V[1] > high:
            yield ValidationFault(("span_V",), f"a span inside range_V, {low:g} to {high:g} V")

    def reach_faults(self, limits: Limits) -> ValidationFaults:
        """A span that does not include the permitted pressures, and supplies that do not reach them."""
        yield from range_faults("span_bar", self.span_bar, limits)
        yield from self.supply_faults(limits)


class BusValve(RegulatingValve):
    """A pressure regulator that takes its set-point as a number, over a bus.

    `vent_bar` is the gauge pressure of its exhaust, which need not be the bottom of the range: with a vacuum supply the
    range begins below it.
    """

    type: Literal["bus"]
    safe_state: Literal["vent"] = "vent"
    range_bar: BarSpan
    vent_bar: Number = Field(default=0.0, ge=-1, le=1)

    @property
    def output_unit(self) -> str:
        return "bar"

    @property
    def output_range(self) -> tuple[float, float]:
        return self.range_bar

    @property
    def vent_output(self) -> float:
        return self.vent_bar

    @property
    def vented_pa(self) -> float:
        """The gauge pressure of the exhaust."""
        return self.vent_bar * PA_PER_BAR

    def regulator(self, limits: Limits, control: Control) -> PressureRegulator:
        """The set-point, from pascal to bar."""
        low, high = self.range_bar
        return PressureRegulator(*self._filter(limits, control), low * PA_PER_BAR, high * PA_PER_BAR, low, high)

    def simulated(self, truth: SimulatedValve) -> ValveTruth:
        return self.held(ValveTruth(pa_at_zero=ATMOSPHERE_PA, pa_per_unit=PA_PER_BAR))

    def faults(self) -> ValidationFaults:
        """A vent level outside the range."""
        low, high = self.range_bar
        if not low <= self.vent_bar <= high:
            yield ValidationFault(("vent_bar",), f"a pressure inside range_bar, {low:g} to {high:g} bar")

    def reach_faults(self, limits: Limits) -> ValidationFaults:
        """A range that does not include the permitted pressures, and supplies that do not reach them."""
        yield from range_faults("range_bar", self.range_bar, limits)
        yield from self.supply_faults(limits)
