"""The pressure regulator of one valve: a pure step function from set-point and measured pressure to output.

The valve's type has the law from the filtered set-point to the output (`rig.valves`). Pressures are gauge, SI
throughout.
"""

from __future__ import annotations

import math

from rig.valves.base import Regulator, RegulatorState


def step(
    regulator: Regulator, state: RegulatorState, dt_s: float, measured_pa: float, setpoint_pa: float, rate_pa_s: float
) -> RegulatorState:
    """Advance one valve by `dt_s`: the set-point and its rate of change belong to the new instant."""
    before = state.reference_pa
    if math.isnan(before):
        before = max(measured_pa, regulator.lowest_pa)
    reference = _follow(before, setpoint_pa, rate_pa_s, regulator.filter_per_s, regulator.rate_limit_pa_s, dt_s)
    return regulator.command(state.integral_pa_s, dt_s, measured_pa, reference, (reference - before) / dt_s)


def _follow(reference: float, setpoint: float, rate: float, bandwidth: float, limit: float, dt: float) -> float:
    """Set-point filter: exact for a ramp at its stated rate, first order within the rate limit for a step."""
    carried = reference + rate * dt
    wanted = carried + (setpoint - carried) * (1.0 - math.exp(-bandwidth * dt))
    return min(max(wanted, reference - limit * dt), reference + limit * dt)
