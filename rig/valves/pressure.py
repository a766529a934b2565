"""An electro-pneumatic regulator: it takes a set-point voltage and holds the pressure by itself."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

from typing import Literal

from model.units import PA_PER_BAR
from protocols.validation import ValidationFault
from rig.sections.control import Control, Limits
from rig.sections.quantities import BarSpan, VoltSpan
from rig.valves.base import SimulatedValve, ValidationFaults, ValveTruth, VoltageValve
from rig.valves.iso6358 import ATMOSPHERE_PA
from rig.valves.regulating import PressureRegulator, RegulatingValve, range_faults


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
