"""Valves that hold the pressure by themselves: what these types share."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from model.units import PA_PER_BAR
from protocols.validation import ValidationFault
from rig.sections.control import Limits
from rig.sections.quantities import Bar
from rig.valves.base import Regulator, RegulatorState, ValidationFaults, ValveSection, ValveTruth
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
    vacuum_bar: Annotated[float, Field(ge=-1, le=0, allow_inf_nan=False, strict=True)] = Field(
        default=0.0, description="gauge pressure of the vacuum supply; 0: the exhaust is the atmosphere"
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
