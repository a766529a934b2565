"""A valve type that meters flow is calibrated by its own keys, without a change of the calibration."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rig.calibrate.valve_fit import RateMeasurement, fit
from rig.config import loader
from rig.valves.flow import FlowValve
from rig.valves.iso6358 import ANR_PA, ATMOSPHERE_PA, flow_function, sonic_conductance
from rig.valves.metering import FlowMetering, MeasuredFlow
from rig.valves.pressure import PressureValve


class MilliVoltValve(FlowValve):
    """A flow valve whose rig file states the closed voltage in millivolts."""

    closed_mV: float = 5000.0  # noqa: N815 - volts keep their capital

    @property
    def metering(self) -> FlowMetering:
        """The closed voltage from its own key."""
        return replace(super().metering, closed_v=self.closed_mV / 1e3)

    def calibrated(self, found: MeasuredFlow) -> dict[str, Any]:
        """The closed voltage under its own key."""
        keys = super().calibrated(found)
        return {**keys, "closed_mV": 1e3 * keys.pop("closed_V")}


def stated() -> FlowValve:
    """The first valve of the mock rig."""
    valve = loader.load("mock").valves[0]
    assert isinstance(valve, FlowValve)
    return valve


def of_type(kind: type[FlowValve], **keys: object) -> FlowValve:
    """That valve as another type."""
    return kind.model_validate({**stated().model_dump(), **keys})


def rates(metering: FlowMetering, volume_m3: float, shift_v: float) -> list[RateMeasurement]:
    """Rates of an ideal valve whose closed voltage lies `shift_v` beside the stated one, by ISO 6358."""
    share = np.array(metering.curve_percent) / 100
    curve_v = np.array(metering.curve_v)
    begin = curve_v > metering.dead_zone_v
    found = [RateMeasurement(0.0, True, pressure, 0.0, 1.0) for pressure in (1e4, 3e4)]
    for size in np.arange(0.2, 2.0, 0.02):
        for side, pressure in ((1, 1e4), (-1, 3e4)):
            chamber = pressure + ATMOSPHERE_PA
            up, down = (metering.supply_pa, chamber) if side > 0 else (chamber, ATMOSPHERE_PA)
            at = abs(side * size - shift_v)
            opened = np.interp(at, [metering.dead_zone_v, *curve_v[begin]], [0.0, *share[begin]])
            conductance = opened * sonic_conductance(metering.full_flow_l_min, metering.critical_ratio)
            flow = side * conductance * up * flow_function(down / up, metering.critical_ratio)
            found += [
                RateMeasurement(side * size, way, pressure, flow * ANR_PA / volume_m3, 1.0) for way in (True, False)
            ]
    return found


@pytest.mark.parametrize("fills", ["above", "below"])
def test_the_fit_finds_the_closed_voltage_of_an_ideal_valve(fills: str) -> None:
    metering = of_type(MilliVoltValve, fills=fills, closed_mV=4900.0).metering
    measured = rates(metering, 2e-5, shift_v=0.05)
    found = fit(metering, measured, [2e-5] * len(measured))
    assert found.closed_v == pytest.approx(4.9 + math.copysign(0.05, metering.fill_sign), abs=0.005)
    assert found.dead_zone_v == pytest.approx(metering.dead_zone_v, abs=0.01)
    assert found.leakage_l_min == pytest.approx(0.0, abs=1e-6)


def test_a_type_with_other_keys_takes_the_calibration_by_them() -> None:
    valve = of_type(MilliVoltValve)
    new = of_type(MilliVoltValve, **valve.calibrated(of_type(FlowValve, closed_V=4.8)))
    assert new.metering == replace(valve.metering, closed_v=4.8)


def test_a_valve_that_regulates_by_itself_has_no_metering() -> None:
    valve = PressureValve(type="pressure", actuators=(1,), card="card", channel=0, span_bar=(0.0, 2.0))
    assert valve.metering is None
    with pytest.raises(NotImplementedError):
        valve.calibrated(stated())
