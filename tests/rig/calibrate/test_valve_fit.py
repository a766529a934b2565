"""The fit of a flow-metering valve to pressure rates."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.calibrate.valve_fit import RateMeasurement, fit
from rig.config import loader
from rig.valves.flow import FlowValve
from rig.valves.iso6358 import ANR_PA, ATMOSPHERE_PA, flow_function, sonic_conductance
from rig.valves.metering import MeteringValve


def stated(**keys: object) -> FlowValve:
    """The first valve of the mock rig, with other keys."""
    valve = loader.load("mock").valves[0]
    assert isinstance(valve, FlowValve)
    return FlowValve.model_validate({**valve.model_dump(), **keys})


def rates(valve: MeteringValve, volume_m3: float, shift_v: float) -> list[RateMeasurement]:
    """Rates of an ideal valve whose closed voltage lies `shift_v` beside the stated one, by ISO 6358."""
    share = np.array(valve.flow_curve_percent) / 100
    curve_v = np.array(valve.flow_curve_V)
    begin = curve_v > valve.dead_zone_V
    found = [RateMeasurement(0.0, True, pressure, 0.0, 1.0) for pressure in (1e4, 3e4)]
    for size in np.arange(0.2, 2.0, 0.02):
        for side, pressure in ((1, 1e4), (-1, 3e4)):
            chamber = pressure + ATMOSPHERE_PA
            up, down = (valve.absolute_supply_pa, chamber) if side > 0 else (chamber, ATMOSPHERE_PA)
            at = abs(side * size - shift_v)
            opened = np.interp(at, [valve.dead_zone_V, *curve_v[begin]], [0.0, *share[begin]])
            conductance = opened * sonic_conductance(valve.full_flow_l_min, valve.critical_ratio)
            flow = side * conductance * up * flow_function(down / up, valve.critical_ratio)
            found += [
                RateMeasurement(side * size, way, pressure, flow * ANR_PA / volume_m3, 1.0) for way in (True, False)
            ]
    return found


@pytest.mark.parametrize("fills", ["above", "below"])
def test_the_fit_finds_the_closed_voltage_of_an_ideal_valve(fills: str) -> None:
    valve = stated(fills=fills, closed_V=4.9)
    measured = rates(valve, 2e-5, shift_v=0.05)
    found = fit(valve, measured, [2e-5] * len(measured))
    assert found.closed_v == pytest.approx(4.9 + math.copysign(0.05, valve.fill_sign), abs=0.005)
    assert found.dead_zone_v == pytest.approx(valve.dead_zone_V, abs=0.01)
    assert found.leakage_l_min == pytest.approx(0.0, abs=1e-6)
