"""A valve that meters flow by a voltage: its keys in the rig file, which `rig calibrate pressure` measures."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from model.units import PA_PER_BAR
from protocols.validation import ValidationFault
from rig.sections.control import Limits
from rig.sections.quantities import Bar, NonNegative, Positive, Volt
from rig.valves.base import Regulator, ValidationFaults, VoltageValve
from rig.valves.iso6358 import ATMOSPHERE_PA

CALIBRATED_KEYS = ("closed_V", "dead_zone_V", "full_flow_l_min", "flow_curve_V", "flow_curve_percent")
"""Keys of a flow valve that a calibration file sets."""


class MeteringRegulator(Regulator):
    """The regulator of a valve that meters flow, which a calibration also opens to a voltage."""

    @abstractmethod
    def opening_v(self, offset_v: float) -> float:
        """The voltage of an opening at an offset from the closed voltage; positive fills."""

    @abstractmethod
    def opening_rate_pa_s(self, offset_v: float, pressure_pa: float) -> float:
        """The rate of the gauge pressure that this opening should cause [Pa/s]."""


class MeteringValve(VoltageValve):
    """A valve whose voltage meters the flow to or from the supply and the exhaust, by a curve of the rig file."""

    closed_V: Volt = 5.0
    fills: Literal["above", "below"] = "above"
    dead_zone_V: NonNegative
    full_flow_l_min: Positive = Field(le=100_000, description="normal litres per minute fully open at 6 -> 5 bar gauge")
    flow_curve_V: Annotated[tuple[NonNegative, ...], Field(min_length=2)] = Field(description="volts from closed")
    flow_curve_percent: Annotated[tuple[NonNegative, ...], Field(min_length=2)] = Field(description="of full flow")
    supply_bar: Bar = Field(description="gauge pressure at the supply port")
    critical_ratio: Positive = Field(default=0.3, lt=1, description="b of ISO 6358")

    @property
    def fill_sign(self) -> float:
        """+1 where a higher voltage fills the chamber, -1 where a lower one does."""
        return 1.0 if self.fills == "above" else -1.0

    @property
    def vent_output(self) -> float:
        """The voltage that opens the valve to the exhaust completely."""
        return self.range_V[0] if self.fills == "above" else self.range_V[1]

    @property
    def closed_output(self) -> float:
        """The middle of the dead zone."""
        return self.closed_V

    @property
    def fills_at_power_up(self) -> bool:
        return self.fills == "below"

    @property
    def absolute_supply_pa(self) -> float:
        """The absolute pressure at the supply port."""
        return self.supply_bar * PA_PER_BAR + ATMOSPHERE_PA

    def faults(self) -> ValidationFaults:
        """A closed voltage outside the range, and faults of the curve."""
        low, high = self.range_V
        if not low < self.closed_V < high:
            yield ValidationFault(("closed_V",), f"a voltage inside range_V, {low:g} to {high:g} V")
        yield from flow_curve_faults(self.flow_curve_V, self.flow_curve_percent, self.dead_zone_V)

    def reach_faults(self, limits: Limits) -> ValidationFaults:
        """A supply that is too low, and a vacuum, which its exhaust to the atmosphere cannot reach."""
        if self.supply_bar <= limits.pressure_bar:
            expected = f"more than limits, pressure_bar ({limits.pressure_bar:g} bar): the valve cannot fill that far"
            yield ValidationFault(("supply_bar",), expected)
        if limits.lowest_pressure_bar < 0:
            lowest = f"limits, lowest_pressure_bar ({limits.lowest_pressure_bar:g} bar)"
            yield ValidationFault(("type",), f"pressure or bus for {lowest}: a flow valve vents to the atmosphere")


def flow_curve_faults(volts: Sequence[float], percent: Sequence[float], dead_zone_v: float) -> ValidationFaults:
    """Yield the faults of a stated or calibrated flow curve; paths start at the valve's section."""
    if len(volts) != len(percent):
        expected = f"{len(volts)} values, as many as flow_curve_V has, not {len(percent)}"
        yield ValidationFault(("flow_curve_percent",), expected)
    for name, values in (("flow_curve_V", volts), ("flow_curve_percent", percent)):
        if values[0] != 0:
            yield ValidationFault((name, 0), "0: the curve begins at the closed valve")
        for i, (a, b) in enumerate(itertools.pairwise(values)):
            if b <= a:
                yield ValidationFault((name, i + 1), f"more than the value before, {a:g}: the curve must rise")
    if percent[-1] > 100:
        yield ValidationFault(("flow_curve_percent", len(percent) - 1), "at most 100 (% of full flow)")
    if dead_zone_v >= volts[-1]:
        yield ValidationFault(("dead_zone_V",), f"less than the end of flow_curve_V, {volts[-1]:g} V")
