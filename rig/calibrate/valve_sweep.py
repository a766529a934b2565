"""Sweep of a flow-metering valve: pressure rates by voltage, and the section of the calibration file from them."""

from __future__ import annotations

import math

import numpy as np

from calibration.camera import CalibrationError
from model import Arm
from model.arrays import Array
from model.statics import statics
from model.units import PA_PER_BAR
from rig.calibrate import file_sections
from rig.calibrate.bench_driver import BenchDriver
from rig.calibrate.valve_fit import FittedValve, RateMeasurement, fit
from rig.config import calibration_schema
from rig.config.arm_model import chamber_areas_m2, model_arm
from rig.config.calibration_files import rounded
from rig.config.schema import RigConfig
from rig.control.interlocks.conditions import PressureRate
from rig.valves.iso6358 import ATMOSPHERE_PA
from rig.valves.metering import MeteringValve

FILL_FROM, VENT_FROM, BAND = 0.25, 0.75, 0.14
"""Pressures at which a sweep opens the valve, and how far it lets them move; of the highest set-point."""
OFFSETS_V = (*np.round(np.arange(0.20, 0.951, 0.05), 3), *np.round(np.arange(1.05, 5.0, 0.1), 3))
REACH_S, REST_S, WATCH_S, SKIP_S, LEAK_S, VENT_S = 0.5, 0.05, 0.3, 0.03, 0.6, 1.2
KICK_V, KICK_S = 0.06, 0.02
"""Further out for a moment, so that the spool then comes from outside."""
FASTEST_SHARE = 0.6
"""Share of the rate at which the interlock trips; the sweep ends there."""
_LEAST_ROWS = 8


def sweep(config: RigConfig, driver: BenchDriver, index: int) -> list[RateMeasurement]:
    """Open one valve to more and more voltages, either side, out and back; watch how fast the pressure moves."""
    valve = _metering_valve(config, index)
    highest = config.limits.pressure_bar * PA_PER_BAR
    chambers = [a - 1 for a in valve.actuators]

    def reach(share: float) -> None:
        """Regulate to a pressure, then close the valve and let the spool come to rest."""
        level = np.zeros(config.actuators)
        level[chambers] = share * highest
        driver.regulate(level, REACH_S)
        driver.open_valve(index, 0.0, REST_S)

    def watch(offset_v: float, outward: bool, seconds: float) -> RateMeasurement:
        log = driver.open_valve(index, offset_v, seconds, BAND * highest)
        return rate_of(log.time_s, log.pressure_pa[:, chambers].mean(axis=1), offset_v, outward)

    rates: list[RateMeasurement] = []
    for share in (FILL_FROM, VENT_FROM):
        reach(share)
        rates.append(watch(0.0, True, LEAK_S))
    limit = FASTEST_SHARE * PressureRate(config, config.sensors[0]).limit_pa_s
    going = {1.0: True, -1.0: True}
    fastest = {1.0: (0.0, 0.0), -1.0: (0.0, 0.0)}
    low_v, high_v = valve.range_V
    room_v = min(valve.closed_V - low_v, high_v - valve.closed_V) - KICK_V
    for offset in (float(v) for v in OFFSETS_V if v <= room_v):
        for side, share in ((1.0, FILL_FROM), (-1.0, VENT_FROM)):
            if not going[side]:
                continue
            reach(share)
            out = watch(side * offset, True, WATCH_S)
            driver.open_valve(index, side * (offset + KICK_V), KICK_S, BAND * highest)
            back = watch(side * offset, False, WATCH_S)
            rates += [out, back]
            before_v, before = fastest[side]
            now = max(abs(out.rate_pa_s), abs(back.rate_pa_s))
            slope = (now - before) / (offset - before_v)
            fastest[side] = offset, now
            # The next voltage, with a curve that grows steeper, must stay clear of the interlock.
            going[side] = now + 1.6 * slope * 0.1 < limit
    driver.regulate(np.zeros(config.actuators), VENT_S)
    return rates


def _metering_valve(config: RigConfig, index: int) -> MeteringValve:
    valve = config.valves[index]
    assert isinstance(valve, MeteringValve), f"valve {index + 1} does not meter flow"
    return valve


def rate_of(time_s: Array, pressure_pa: Array, offset_v: float, outward: bool) -> RateMeasurement:
    """Fit a line to a pressure (n,), without the time at its beginning in which the spool still moves.

    Raises:
        CalibrationError: there are too few samples.
    """
    late = time_s > min(SKIP_S, time_s[-1] / 2 if len(time_s) else 0.0)
    time_s, pressure_pa = time_s[late], pressure_pa[late]
    if len(time_s) < _LEAST_ROWS:
        raise CalibrationError("too few samples while a valve was open: the card's sampling_hz is too low")
    passed = time_s - time_s.mean()
    spread = float(passed @ passed)
    mean, rate = float(pressure_pa.mean()), float(passed @ pressure_pa) / spread
    rest = pressure_pa - mean - rate * passed
    return RateMeasurement(offset_v, outward, mean, rate, math.sqrt(float(rest @ rest) / (len(rest) - 2) / spread))


def volume_m3(config: RigConfig, chambers: list[int], rest_m3: float, pressure_pa: float, arm: Arm) -> float:
    """Effective air volume V + p dV/dp of some chambers: one that lengthens with its pressure takes in more."""
    step = 0.05 * config.limits.pressure_bar * PA_PER_BAR
    areas_m2 = chamber_areas_m2(config.arm.chain)[chambers]
    volumes = []
    for at in (0.0, pressure_pa - step, pressure_pa + step):
        pressures = np.zeros(config.actuators)
        pressures[chambers] = max(at, 0.0)
        volumes.append(float(areas_m2 @ statics(arm, pressures).actuator_lengths_m[chambers]))
    rest, below, above = volumes
    grown = (below + above) / 2 - rest
    return rest_m3 + grown + (pressure_pa + ATMOSPHERE_PA) * (above - below) / (2 * step)


def valve_section(
    config: RigConfig, index: int, rates: list[RateMeasurement], volume_ml: float, volume_std_ml: float
) -> calibration_schema.ValveCalibration:
    """One valve from its rates; `volume_ml` is one chamber's with its tube."""
    chambers = [a - 1 for a in config.valves[index].actuators]
    count, arm = len(chambers), model_arm(config)
    volumes = [volume_m3(config, chambers, count * volume_ml * 1e-6, r.pressure_pa, arm) for r in rates]
    found = fit(_metering_valve(config, index), rates, volumes)
    return _valve_section(config, index, found, volume_ml * count, volume_std_ml * count)


def _valve_section(
    config: RigConfig, index: int, found: FittedValve, volume_ml: float, volume_std_ml: float
) -> calibration_schema.ValveCalibration:
    valve = _metering_valve(config, index)
    full = found.full_l_min
    return calibration_schema.ValveCalibration(
        valve=index + 1,
        card=file_sections.card_of(config, valve.card),
        channel=valve.channel,
        closed_V=rounded(found.closed_v),
        closed_std_V=rounded(found.closed_std_v, 3),
        dead_zone_V=rounded(found.dead_zone_v),
        dead_zone_std_V=rounded(found.dead_zone_std_v, 3),
        hysteresis_V=rounded(found.hysteresis_v, 3),
        leakage_l_min=rounded(found.leakage_l_min, 4),
        leakage_std_l_min=rounded(found.leakage_std_l_min, 3),
        full_flow_l_min=rounded(full),
        flow_curve_V=rounded(found.curve_v, 5),
        flow_curve_percent=rounded(np.minimum(100 * found.curve_l_min / full, 100.0), 6),
        flow_curve_std_percent=rounded(100 * found.curve_std_l_min / full, 3),
        measured_to_V=rounded(found.measured_to_v, 4),
        volume_ml=rounded(volume_ml, 5),
        volume_std_ml=rounded(volume_std_ml, 3),
        supply_bar=rounded(valve.supply_bar),
        rms_l_min=rounded(float(np.sqrt(np.mean(found.residuals_l_min**2))), 4),
        points=tuple(
            calibration_schema.FlowPoint(
                offset_V=rounded(v, 5), flow_l_min=rounded(f, 5), std_l_min=rounded(s, 3), residual_l_min=rounded(r, 3)
            )
            for v, f, s, r in zip(
                found.offsets_v, found.flows_l_min, found.stds_l_min, found.residuals_l_min, strict=True
            )
        ),
    )
