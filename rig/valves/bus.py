"""A pressure regulator on a bus: it takes the set-point itself, as a number."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from model.units import PA_PER_BAR
from protocols.validation import ValidationFault
from rig.sections.control import Control, Limits
from rig.sections.quantities import BarSpan
from rig.valves.base import SimulatedValve, ValidationFaults, ValveTruth
from rig.valves.iso6358 import ATMOSPHERE_PA
from rig.valves.regulating import PressureRegulator, RegulatingValve, range_faults


class BusValve(RegulatingValve):
    """A pressure regulator that takes its set-point as a number, over a bus.

    `vent_bar` is the gauge pressure of its exhaust, which need not be the bottom of the range: with a vacuum supply the
    range begins below it.
    """

    type: Literal["bus"]
    safe_state: Literal["vent"] = "vent"
    range_bar: BarSpan
    vent_bar: Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False, strict=True)] = 0.0

    @property
    def output_unit(self) -> str:
        return "bar"

    @property
    def output_range(self) -> tuple[float, float]:
        """Range of the set-point [bar]."""
        return self.range_bar

    @property
    def vent_output(self) -> float:
        """The set-point that vents [bar]."""
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
