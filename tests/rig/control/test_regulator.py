"""The regulator's pieces: the inverse of the valve, the set-point filter, anti-windup."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.step import regulate
from rig.valves.base import RegulatorState
from rig.valves.flow import SOFT_FRACTION, FlowRegulator, FlowValve
from rig.valves.iso6358 import ANR_PA, ATMOSPHERE_PA, flow_function, sonic_conductance
from tests.support.plant_bench import mock_rig

RIG = mock_rig()
DT = 0.005


def flow_settings(**changes: object) -> FlowRegulator:
    config = mock_rig(**changes)
    settings = config.valves[0].regulator(config.limits, config.control)
    assert isinstance(settings, FlowRegulator)
    return settings


def test_the_conductance_gives_back_the_data_sheets_flow() -> None:
    c = sonic_conductance(100.0, 0.3)
    upstream, downstream = 6e5 + ATMOSPHERE_PA, 5e5 + ATMOSPHERE_PA
    assert c * upstream * flow_function(downstream / upstream, 0.3) * 60_000 == pytest.approx(100.0)


def test_a_quarter_inch_valve_has_the_conductance_known_for_it() -> None:
    assert sonic_conductance(1400.0, 0.3) * 1e8 == pytest.approx(5.5, rel=0.15)  # DESIGN: 6.25 l/(s bar), b 0.23-0.5


@given(st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_the_flow_function_falls_from_one_to_zero(a: float, b: float) -> None:
    low, high = sorted((a, b))
    assert 0.0 <= flow_function(high, 0.3) <= flow_function(low, 0.3) <= 1.0


def test_the_flow_function_has_no_jump_where_the_line_begins() -> None:
    assert flow_function(0.995 - 1e-9, 0.3) == pytest.approx(flow_function(0.995 + 1e-9, 0.3), abs=1e-6)


@given(st.floats(0.02, 0.69), st.floats(-0.9, 0.9))
def test_the_voltage_lets_exactly_the_asked_rate_through_a_valve_as_stated(bar: float, rate_bar_s: float) -> None:
    s = flow_settings()
    valve = RIG.valves[0]
    assert isinstance(valve, FlowValve)
    out = regulate(s, RegulatorState(bar * 1e5, 0.0, 0.0, 5.0), DT, bar * 1e5, bar * 1e5, rate_bar_s * 1e5)
    volts, fractions = valve.opening_curve(valve.dead_zone_V)
    offset = out.output - 5.0
    fraction = float(np.interp(abs(offset), volts, fractions))
    chamber = bar * 1e5 + ATMOSPHERE_PA
    upstream, downstream = (2.5e5 + 1325.0, chamber) if offset > 0 else (chamber, ATMOSPHERE_PA)
    ease = max(flow_function(downstream / upstream, 0.3), 0.15)
    flow = math.copysign(fraction * s.conductance * upstream * ease, offset)
    if fraction > SOFT_FRACTION:
        assert flow * ANR_PA / s.volume_m3 == pytest.approx(out.demand_pa_s, rel=1e-6)
    else:
        assert abs(out.demand_pa_s) <= SOFT_FRACTION * s.conductance * upstream * ANR_PA / s.volume_m3 * 1.001


@pytest.mark.parametrize(("fills", "sign"), [("above", 1), ("below", -1)])
def test_filling_uses_the_side_that_the_rig_states(fills: str, sign: int) -> None:
    s = flow_settings(valves__0__fills=fills)
    filling = regulate(s, RegulatorState(), DT, 0.2e5, 0.5e5, 0.0)
    emptying = regulate(s, RegulatorState(), DT, 0.5e5, 0.2e5, 0.0)
    assert sign * (filling.output - 5.0) > 0.4
    assert sign * (emptying.output - 5.0) < -0.4


@pytest.mark.parametrize(("fills", "vent_output"), [("above", 0.0), ("below", 10.0)])
def test_a_set_point_of_zero_opens_the_chamber_to_the_exhaust(fills: str, vent_output: float) -> None:
    assert regulate(flow_settings(valves__0__fills=fills), RegulatorState(), DT, 0.0, 0.0, 0.0).output == vent_output


@given(st.floats(0.05, 0.7), st.floats(0.05, 0.7))
def test_the_reference_reaches_a_step_within_the_rate_limit_and_never_passes_it(start: float, stop: float) -> None:
    s = flow_settings()
    state = RegulatorState(start * 1e5)
    for _ in range(400):
        after = regulate(s, state, DT, state.reference_pa, stop * 1e5, 0.0)
        assert abs(after.reference_pa - state.reference_pa) <= s.rate_limit_pa_s * DT * (1 + 1e-9)
        assert min(start, stop) * 1e5 - 1e-6 <= after.reference_pa <= max(start, stop) * 1e5 + 1e-6
        state = after
    assert state.reference_pa == pytest.approx(stop * 1e5, abs=1.0)


def test_the_reference_does_not_lag_a_set_point_that_says_how_fast_it_moves() -> None:
    s = flow_settings()
    state = RegulatorState(0.2e5)
    for k in range(1, 100):
        target = 0.2e5 + 0.3e5 * k * DT
        state = regulate(s, state, DT, target, target, 0.3e5)
        assert state.reference_pa == pytest.approx(target, abs=1e-6)


def test_the_integral_does_not_wind_up_while_the_valve_saturates() -> None:
    s = flow_settings()
    state = RegulatorState(0.6e5, 0.0, 0.0, 5.0)
    for _ in range(400):
        state = regulate(s, state, DT, 0.0, 0.6e5, 0.0)
    assert state.output == pytest.approx(9.62)
    assert state.integral_pa_s == 0.0


def test_the_integral_holds_no_more_than_a_leaking_valve_could_explain() -> None:
    s = flow_settings()
    state = RegulatorState(0.3e5, 0.0, 0.0, 5.0)
    for _ in range(4000):
        state = regulate(s, state, DT, 0.29e5, 0.3e5, 0.0)
    supply = 1.5e5 + ATMOSPHERE_PA
    assert state.integral_pa_s == pytest.approx(0.15 * s.conductance * supply * ANR_PA / s.volume_m3)
