"""The pressure regulator of one valve: a pure step function from set-point and measured pressure to voltage.

The physics and the reasons for the terms are in docs/explanation/control.md. Pressures are gauge, SI throughout.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR, FlowValve, PressureValve
from rig.control.valve import ANR_PA, ATMOSPHERE_PA, fill_sign, flow_function, opening_curve, sonic_conductance, vent_v

REFERENCE_SHARE = 0.5
"""Bandwidth of the set-point filter as a share of the loop's: it is slower than the disturbance rejection."""

SOFT_FRACTION = 0.005
"""Smaller openings cross the dead zone linearly instead of with a jump, so that noise does not wear the spool."""

FLOW_FUNCTION_FLOOR = 0.15
"""Lower bound of the flow function as a divisor; reached when the chamber is within about 0.01 bar of the port."""

LARGEST_LEAK = 0.15
"""Bound of the integral as a fraction of the full choked flow from the supply: data sheets specify at most 0.07."""

VENTED_PA = 500.0
"""A lower reference means an empty chamber: the valve is opened to the exhaust without regulation."""


@dataclass(frozen=True)
class FlowSettings:
    """Regulator settings of a flow-metering valve."""

    actuators: tuple[int, ...]
    rate_limit_pa_s: float
    filter_per_s: float
    gain_per_s: float
    integral_per_s2: float
    volume_m3: float
    conductance: float
    critical_ratio: float
    supply_pa: float
    closed_v: float
    fill_sign: float
    vent_v: float
    low_v: float
    high_v: float
    fractions: tuple[float, ...]
    offsets_v: tuple[float, ...]


@dataclass(frozen=True)
class PressureSettings:
    """Regulator settings of a valve with its own pressure regulator, whose set-point is a voltage."""

    actuators: tuple[int, ...]
    rate_limit_pa_s: float
    filter_per_s: float
    low_pa: float
    high_pa: float
    low_v: float
    high_v: float


Settings = FlowSettings | PressureSettings


class RegulatorState(NamedTuple):
    """State of one regulator after a step; `valve_v` is the voltage to write.

    `reference_pa` is the set-point after the rate limit, `asked_pa_s` the rate of pressure change that the voltage
    should cause, `integral_pa_s` its part that compensates leakage. `reference_pa` is NaN before the first
    step, which starts it at the measured pressure.
    """

    reference_pa: float = math.nan
    integral_pa_s: float = 0.0
    asked_pa_s: float = 0.0
    valve_v: float = math.nan


def settings(valve: FlowValve | PressureValve, config: RigConfig) -> Settings:
    """The regulator settings of one valve of the rig, in SI."""
    actuators = tuple(a - 1 for a in valve.actuators)
    rate_limit = config.limits.rate_bar_per_s * PA_PER_BAR
    gain = 2 * math.pi * config.control.bandwidth_hz
    if isinstance(valve, PressureValve):
        (low_v, high_v), (low_bar, high_bar) = valve.span_V, valve.span_bar
        return PressureSettings(
            actuators, rate_limit, REFERENCE_SHARE * gain, low_bar * PA_PER_BAR, high_bar * PA_PER_BAR, low_v, high_v
        )
    volts, fractions = opening_curve(valve, valve.dead_zone_V)
    soft_v = _interpolate(SOFT_FRACTION, fractions, volts)
    above = [(f, v) for f, v in zip(fractions, volts, strict=True) if f > SOFT_FRACTION]
    return FlowSettings(
        actuators=actuators,
        rate_limit_pa_s=rate_limit,
        filter_per_s=REFERENCE_SHARE * gain,
        gain_per_s=gain,
        integral_per_s2=gain / config.control.integral_s,
        volume_m3=config.control.volume_ml * 1e-6 * len(actuators),
        conductance=sonic_conductance(valve.full_flow_l_min, valve.critical_ratio),
        critical_ratio=valve.critical_ratio,
        supply_pa=valve.supply_bar * PA_PER_BAR,
        closed_v=valve.closed_V,
        fill_sign=fill_sign(valve),
        vent_v=vent_v(valve),
        low_v=valve.range_V[0],
        high_v=valve.range_V[1],
        fractions=(0.0, SOFT_FRACTION, *(f for f, _ in above)),
        offsets_v=(0.0, soft_v, *(v for _, v in above)),
    )


def step(
    s: Settings, state: RegulatorState, dt_s: float, measured_pa: float, setpoint_pa: float, rate_pa_s: float
) -> RegulatorState:
    """Advance one valve by `dt_s`: the set-point and its rate of change belong to the new instant."""
    before = state.reference_pa
    if math.isnan(before):
        before = max(measured_pa, 0.0)
    reference = _follow(before, setpoint_pa, rate_pa_s, s.filter_per_s, s.rate_limit_pa_s, dt_s)
    reference_rate = (reference - before) / dt_s
    if isinstance(s, PressureSettings):
        fraction = (reference - s.low_pa) / (s.high_pa - s.low_pa)
        volts = s.low_v + min(max(fraction, 0.0), 1.0) * (s.high_v - s.low_v)
        return RegulatorState(reference, 0.0, reference_rate, volts)
    return _meter(s, state.integral_pa_s, dt_s, measured_pa, reference, reference_rate)


def _follow(reference: float, setpoint: float, rate: float, bandwidth: float, limit: float, dt: float) -> float:
    """Set-point filter: exact for a ramp at its stated rate, first order within the rate limit for a step."""
    carried = reference + rate * dt
    wanted = carried + (setpoint - carried) * (1.0 - math.exp(-bandwidth * dt))
    return min(max(wanted, reference - limit * dt), reference + limit * dt)


def _meter(
    s: FlowSettings, integral: float, dt: float, measured: float, reference: float, reference_rate: float
) -> RegulatorState:
    if reference < VENTED_PA and reference_rate <= 0.0:
        return RegulatorState(reference, integral, integral, s.vent_v)
    error = reference - measured
    asked = reference_rate + s.gain_per_s * error + integral
    supply, chamber = s.supply_pa + ATMOSPHERE_PA, max(measured, 0.0) + ATMOSPHERE_PA
    upstream, downstream = (supply, chamber) if asked > 0.0 else (chamber, ATMOSPHERE_PA)
    ease = max(flow_function(downstream / upstream, s.critical_ratio), FLOW_FUNCTION_FLOOR)
    full_rate = s.conductance * upstream * ease * ANR_PA / s.volume_m3
    fraction = asked / full_rate
    saturated = abs(fraction) >= 1.0
    if saturated:
        fraction = math.copysign(1.0, fraction)
        asked = fraction * full_rate
    if not (saturated and error * fraction > 0.0):
        bound = LARGEST_LEAK * s.conductance * supply * ANR_PA / s.volume_m3
        integral = min(max(integral + s.integral_per_s2 * error * dt, -bound), bound)
    offset = math.copysign(_interpolate(abs(fraction), s.fractions, s.offsets_v), fraction)
    volts = min(max(s.closed_v + s.fill_sign * offset, s.low_v), s.high_v)
    return RegulatorState(reference, integral, asked, volts)


def _interpolate(x: float, xs: tuple[float, ...], ys: tuple[float, ...]) -> float:
    if x >= xs[-1]:
        return ys[-1]
    i = bisect_right(xs, x)
    return ys[i - 1] + (x - xs[i - 1]) * (ys[i] - ys[i - 1]) / (xs[i] - xs[i - 1])
