"""An electro-pneumatic regulator: it takes a set-point voltage and holds the pressure by itself."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from protocols.validation import ValidationFault
from rig.config.sections import PA_PER_BAR, BarSpan, Control, Limits, VoltSpan
from rig.valves.base import Faults, Regulator, RegulatorState, SimulatedValve, ValveTruth, VoltageValve
from rig.valves.iso6358 import ATMOSPHERE_PA


@dataclass(frozen=True)
class PressureRegulator(Regulator):
    """Converts the set-point to a voltage: `low_pa` to `high_pa` (gauge) over `low_v` to `high_v`."""

    low_pa: float
    high_pa: float
    low_v: float
    high_v: float

    def command(
        self, integral_pa_s: float, dt_s: float, measured_pa: float, reference_pa: float, reference_rate_pa_s: float
    ) -> RegulatorState:
        """The voltage of the set-point; no feedback."""
        fraction = (reference_pa - self.low_pa) / (self.high_pa - self.low_pa)
        volts = self.low_v + min(max(fraction, 0.0), 1.0) * (self.high_v - self.low_v)
        return RegulatorState(reference_pa, 0.0, reference_rate_pa_s, volts)


class PressureValve(VoltageValve):
    """An electro-pneumatic regulator that takes a set-point voltage and holds the pressure by itself."""

    type: Literal["pressure"]
    span_V: VoltSpan = (0.0, 10.0)
    span_bar: BarSpan

    @property
    def vent_v(self) -> float:
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
        """The stated characteristic."""
        (low_v, high_v), (low_bar, high_bar) = self.span_V, self.span_bar
        pa_per_v = (high_bar - low_bar) / (high_v - low_v) * PA_PER_BAR
        return ValveTruth(pa_at_zero_v=low_bar * PA_PER_BAR - low_v * pa_per_v + ATMOSPHERE_PA, pa_per_v=pa_per_v)

    def faults(self) -> Faults:
        """A span outside the range of the output."""
        low, high = self.range_V
        if self.span_V[0] < low or self.span_V[1] > high:
            yield ValidationFault(("span_V",), f"a span inside range_V, {low:g} to {high:g} V")

    def reach_faults(self, pressure_bar: float) -> Faults:
        """A span that does not include the permitted pressures."""
        if not self.span_bar[0] <= 0 < pressure_bar <= self.span_bar[1]:
            yield ValidationFault(
                ("span_bar",), f"a span from 0 to limits, pressure_bar ({pressure_bar:g} bar) at least"
            )
