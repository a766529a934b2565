"""A proportional valve that meters flow: regulator and simulation.

The physics and the reasons for the regulator's terms are in docs/explanation/control.md. Pressures are gauge, SI
throughout, where a name does not say otherwise.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Literal

import numpy as np

from protocols.validation import ValidationFault
from rig.sections.control import Control, Limits
from rig.valves.base import RegulatorState, SimulatedValve, ValidationFaults, ValveTruth
from rig.valves.iso6358 import ANR_PA, ATMOSPHERE_PA, flow_function, sonic_conductance
from rig.valves.metering import MeteringRegulator, MeteringValve

SOFT_FRACTION = 0.005
"""Smaller openings cross the dead zone linearly instead of with a jump, so that noise does not wear the spool."""

FLOW_FUNCTION_FLOOR = 0.15
"""Lower bound of the flow function as a divisor; reached when the chamber is within about 0.01 bar of the port."""

LARGEST_LEAK = 0.15
"""Bound of the integral as a fraction of the full choked flow from the supply: data sheets specify at most 0.07."""

ZERO_REFERENCE_PA = 500.0
"""A lower reference means an empty chamber: the valve is opened to the exhaust without regulation."""


@dataclass(frozen=True)
class FlowRegulator(MeteringRegulator):
    """PI control of the pressure with feed-forward, linearised by the flow through the valve (ISO 6358)."""

    valve: FlowValve
    gain_per_s: float
    integral_per_s2: float
    volume_m3: float
    conductance: float
    fractions: tuple[float, ...]
    offsets_v: tuple[float, ...]

    def command(
        self, integral_pa_s: float, dt_s: float, measured_pa: float, reference_pa: float, reference_rate_pa_s: float
    ) -> RegulatorState:
        """The opening whose flow changes the pressure by the wanted rate."""
        integral = integral_pa_s
        if reference_pa < ZERO_REFERENCE_PA and reference_rate_pa_s <= 0.0:
            return RegulatorState(reference_pa, integral, integral, self.valve.vent_output)
        error = reference_pa - measured_pa
        demand = reference_rate_pa_s + self.gain_per_s * error + integral
        full_rate = self._full_rate_pa_s(demand, measured_pa)
        fraction = demand / full_rate
        saturated = abs(fraction) >= 1.0
        if saturated:
            fraction = math.copysign(1.0, fraction)
            demand = fraction * full_rate
        if not (saturated and error * fraction > 0.0):
            bound = LARGEST_LEAK * self.conductance * self.valve.absolute_supply_pa * ANR_PA / self.volume_m3
            integral = min(max(integral + self.integral_per_s2 * error * dt_s, -bound), bound)
        offset = math.copysign(_interpolate(abs(fraction), self.fractions, self.offsets_v), fraction)
        low_v, high_v = self.valve.range_V
        return RegulatorState(reference_pa, integral, demand, min(max(self.opening_v(offset), low_v), high_v))

    def opening_v(self, offset_v: float) -> float:
        return self.valve.closed_V + self.valve.fill_sign * offset_v

    def opening_rate_pa_s(self, offset_v: float, pressure_pa: float) -> float:
        """The rate from the flow through that opening."""
        fraction = float(np.interp(abs(offset_v), self.offsets_v, self.fractions))
        return math.copysign(fraction, offset_v) * self._full_rate_pa_s(offset_v, pressure_pa)

    def _full_rate_pa_s(self, direction: float, pressure_pa: float) -> float:
        """The rate of the pressure, without a sign, of the valve open to the supply (positive) or the exhaust."""
        supply, chamber = self.valve.absolute_supply_pa, max(pressure_pa, 0.0) + ATMOSPHERE_PA
        upstream, downstream = (supply, chamber) if direction > 0.0 else (chamber, ATMOSPHERE_PA)
        ease = max(flow_function(downstream / upstream, self.valve.critical_ratio), FLOW_FUNCTION_FLOOR)
        return self.conductance * upstream * ease * ANR_PA / self.volume_m3


class FlowValve(MeteringValve):
    """A proportional 5/3-way valve that meters flow (Festo MPYE): the chamber hangs on one port, the other is plugged.

    `fills` says on which side of `closed_V` the chamber is connected to the supply.
    """

    type: Literal["flow"]

    def opening_curve(self, dead_zone_v: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Volts from closed and the fraction of the full flow they open, both increasing from the dead zone's edge on.

        With the dead zone of the rig file, this is the curve of the data sheet without its part below the dead zone.
        Another dead zone shifts the whole curve along the voltage axis, like a spool with another overlap.
        """
        shift = dead_zone_v - self.dead_zone_V
        pairs = [
            (v + shift, percent / 100.0)
            for v, percent in zip(self.flow_curve_V, self.flow_curve_percent, strict=True)
            if v > self.dead_zone_V and percent > 0
        ]
        return (dead_zone_v, *(v for v, _ in pairs)), (0.0, *(f for _, f in pairs))

    def regulator(self, limits: Limits, control: Control) -> FlowRegulator:
        gain = 2 * math.pi * control.bandwidth_hz
        volts, fractions = self.opening_curve(self.dead_zone_V)
        soft_v = _interpolate(SOFT_FRACTION, fractions, volts)
        above = [(f, v) for f, v in zip(fractions, volts, strict=True) if f > SOFT_FRACTION]
        return FlowRegulator(
            *self.filter_settings(limits, control),
            valve=self,
            gain_per_s=gain,
            integral_per_s2=gain / control.integral_s,
            volume_m3=control.volume_ml * 1e-6 * len(self.actuators),
            conductance=sonic_conductance(self.full_flow_l_min, self.critical_ratio),
            fractions=(0.0, SOFT_FRACTION, *(f for f, _ in above)),
            offsets_v=(0.0, soft_v, *(v for _, v in above)),
        )

    def simulated(self, truth: SimulatedValve) -> ValveTruth:
        """The stated valve with the true dead zone, flow, leakage and hysteresis."""
        volts, fractions = self.opening_curve(truth.dead_zone_V)
        conductance = truth.flow_scale * sonic_conductance(self.full_flow_l_min, self.critical_ratio)
        return ValveTruth(
            curve_v=volts,
            curve_fraction=fractions,
            conductance=conductance,
            closed_v=self.closed_V,
            fill_sign=self.fill_sign,
            half_hysteresis_v=truth.hysteresis_percent / 200.0 * (self.range_V[1] - self.range_V[0]),
            leak=sonic_conductance(truth.leakage_l_min, self.critical_ratio),
            supply_pa=self.absolute_supply_pa,
            critical_ratio=self.critical_ratio,
        )

    def simulated_faults(self, truth: SimulatedValve) -> ValidationFaults:
        """A dead zone that covers one side of the range, and a leak as large as the flow of the open valve."""
        low, high = self.range_V
        side = min(high - self.closed_V, self.closed_V - low)
        if truth.dead_zone_V >= side > 0:
            expected = f"less than {side:g} V, from closed_V to the nearer end of range_V: the valve would never open"
            yield ValidationFault(("dead_zone_V",), expected)
        if truth.leakage_l_min >= self.full_flow_l_min:
            expected = f"less than full_flow_l_min, {self.full_flow_l_min:g} l/min: the valve would never close"
            yield ValidationFault(("leakage_l_min",), expected)


def _interpolate(x: float, xs: tuple[float, ...], ys: tuple[float, ...]) -> float:
    if x >= xs[-1]:
        return ys[-1]
    i = bisect_right(xs, x)
    return ys[i - 1] + (x - xs[i - 1]) * (ys[i] - ys[i - 1]) / (xs[i] - xs[i - 1])
