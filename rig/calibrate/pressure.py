"""`rig calibrate pressure`: sensors against a reference gauge, valves by a voltage sweep."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer
from numpy.typing import NDArray

from calibration.camera import CalibrationError
from calibration.pressure import SensorFit, fit_sensor
from model import Arm
from model.statics import statics
from protocols import BadInputError, Problem
from rig.calibrate import control_points, file_sections
from rig.calibrate.bench_driver import BenchDriver
from rig.calibrate.bench_session import real, virtual
from rig.calibrate.inputs import bad_input
from rig.calibrate.valve_fit import FittedValve, PressureRate, fit
from rig.cli import calibration_output
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.cli.keyboard import Keyboard
from rig.cli.run_output import confirm
from rig.cli.signals import StopSignals
from rig.config import calibration_schema
from rig.config.arm_model import model_arm
from rig.config.calibration_files import default_path, origin, rounded, sha256_of, write
from rig.config.loader import load, path_of
from rig.config.schema import RigConfig
from rig.config.sections import PA_PER_BAR
from rig.control.interlocks import PressureRate as RateInterlock
from rig.execution.plan import StoppedError
from rig.simulator.plant import Plant
from rig.simulator.plant_launcher import simulated
from rig.valves.flow import FlowValve
from rig.valves.iso6358 import ATMOSPHERE_PA
from runs.overwriting import refuse_existing

Floats = NDArray[np.float64]
Gauge = Callable[[BenchDriver, int], float]
"""Reads the reference gauge [Pa] at the chamber of an actuator (from 0) while the driver regulates."""

LEVELS = (0.15, 0.35, 0.55, 0.75, 0.95)
"""Levels as shares of the highest set-point."""
SETTLE_S, AVERAGE_S = 1.2, 0.5
FILL_FROM, VENT_FROM, BAND = 0.25, 0.75, 0.14
"""Pressures at which a sweep opens the valve, and how far it lets them move; of the highest set-point."""
OFFSETS_V = (*np.round(np.arange(0.20, 0.951, 0.05), 3), *np.round(np.arange(1.05, 5.0, 0.1), 3))
REACH_S, REST_S, WATCH_S, SKIP_S, LEAK_S = 0.5, 0.05, 0.3, 0.03, 0.6
KICK_V, KICK_S = 0.06, 0.02
"""Further out for a moment, so that the spool then comes from outside."""
FASTEST_SHARE = 0.6
"""Of the rate at which the interlock trips: the sweep goes no further."""
VACUUM_BAR = -ATMOSPHERE_PA / PA_PER_BAR
_LEAST_ROWS = 8
_CLIPPED_V = 0.004
_LARGEST_ML = 1e5


@dataclass(frozen=True)
class PressureCalibrationRequest:
    """Options of the command."""

    rig: str
    readings: Path | None
    sensors: bool
    valves: bool
    fast: bool
    gauge: str
    gauge_std_bar: float
    volume_ml: float | None
    volume_std_ml: float | None
    to: Path | None
    replace: bool
    note: str
    yes: bool
    seed: int
    json: bool


def run(request: PressureCalibrationRequest) -> None:
    """Calibrate, write the file, print it.

    Raises:
        BadInputError: the command line, the rig or the readings are invalid.
        CardError, StartError: the bench cannot be driven.
        TrippedError: an interlock tripped; StoppedError: the operator stopped it. The valves are safe.
        CalibrationError: the measurements do not determine the parameters.
    """
    config = load(request.rig)
    if request.to is not None:
        refuse_existing([request.to], replace=request.replace)
    if not 0 < request.gauge_std_bar < 1:
        raise bad_input(
            "--gauge-std-bar", f"{request.gauge_std_bar:g}", "the gauge's standard uncertainty in bar, more than 0"
        )
    for option, value in (("--volume-ml", request.volume_ml), ("--volume-std-ml", request.volume_std_ml)):
        if value is not None and not 0 < value < _LARGEST_ML:
            raise bad_input(option, f"{value:g}", f"millilitres, more than 0 and less than {_LARGEST_ML:g}")
    sensors: tuple[calibration_schema.SensorCalibration, ...] = ()
    valves: tuple[calibration_schema.ValveCalibration, ...] = ()
    used: tuple[calibration_schema.SourceFile, ...] = ()
    screen = console(stderr=request.json)
    if request.readings is not None:
        sensors = _from_readings(config, request.readings, request.gauge_std_bar)
        used = (calibration_schema.SourceFile(name=request.readings.name, sha256=sha256_of(request.readings)),)
    by_gauge = request.sensors and request.readings is None
    if by_gauge or request.valves:
        if not request.yes and not confirm(screen):
            raise bad_input("--yes", "", "consent: pressures will rise; not armed")

        def tell(line: str) -> None:
            screen.print(line, soft_wrap=True)

        with StopSignals() as signals:

            def check() -> None:
                if signals.reason:
                    raise StoppedError(f"stopped {signals.reason}; the valves are in their safe state")

            if request.fast:
                with virtual(config, request.seed) as (bench, ticks, plant):
                    driver = BenchDriver(config, bench, ticks, check)
                    measured = _drive(request, config, driver, _true_gauge(plant, request, tell), by_gauge, tell)
            else:
                rig_file = path_of(request.rig)
                with (
                    simulated(config, rig_file, request.seed),
                    Keyboard() as keys,
                    real(config, rig_file, "rig calibrate pressure") as (held, ticks),
                ):
                    driver = BenchDriver(config, held, ticks, check)
                    measured = _drive(request, config, driver, _typed_gauge(keys, tell), by_gauge, tell)
        # The bench is safe: what takes time comes now.
        for actuator, pairs in sorted(measured.readings.items()):
            sensors += (sensor_section(config, actuator, np.array(pairs), request.gauge_std_bar),)
        volume_ml = request.volume_ml or config.control.volume_ml
        std_ml = request.volume_std_ml if request.volume_std_ml is not None else 0.1 * volume_ml
        valves = tuple(valve_section(config, i, rates, volume_ml, std_ml) for i, rates in measured.rates.items())
    if not (sensors or valves):
        raise bad_input("--no-sensors", "", "something to calibrate: sensors, or a valve that meters flow")
    made = write(
        calibration_schema.PressureFile(
            **origin(request.note), kind="pressure", gauge=request.gauge, gauge_std_bar=request.gauge_std_bar,
            sensors=sensors, valves=valves, sources=used,
        ),
        request.to or default_path(f"pressure-{config.name}"),
        replace=request.replace,
    )  # fmt: skip
    if request.json:
        facts = {
            "file": str(made),
            "sensors": [s.model_dump(mode="json") for s in sensors],
            "valves": [v.model_dump(mode="json") for v in valves],
        }
        typer.echo(json.dumps(plain_json(facts), indent=2))
        return
    calibration_output.pressure(sensors, valves, config, screen)
    typer.echo(calibration_output.written(made, any(card.simulated for card in config.cards.values())))


@dataclass(frozen=True)
class PressureMeasurements:
    """Measurements: volts and gauge [Pa] at each level by actuator, and rates by the valve's index."""

    readings: dict[int, list[tuple[float, float]]]
    rates: dict[int, list[PressureRate]]


def _drive(
    request: PressureCalibrationRequest,
    config: RigConfig,
    driver: BenchDriver,
    gauge: Gauge,
    by_gauge: bool,
    tell: Callable[[str], None],
) -> PressureMeasurements:
    readings = read_gauge(config, driver, gauge, tell) if by_gauge else {}
    rates = {}
    for index, valve in enumerate(config.valves) if request.valves else ():
        if isinstance(valve, FlowValve):
            tell(f"valve {index + 1}: sweep of its voltage")
            rates[index] = sweep(config, driver, index)
    return PressureMeasurements(readings, rates)


def read_gauge(
    config: RigConfig, driver: BenchDriver, gauge: Gauge, tell: Callable[[str], None]
) -> dict[int, list[tuple[float, float]]]:
    """Hold several pressures in every chamber and read sensors and gauge."""
    readings: dict[int, list[tuple[float, float]]] = {s.actuator: [] for s in config.sensors}
    for share in LEVELS:
        level = np.full(config.actuators, share * config.limits.pressure_bar * PA_PER_BAR)
        driver.regulate(level, SETTLE_S)
        for actuator in sorted(readings):
            tell(f"held at {share * config.limits.pressure_bar:.3f} bar; the gauge on actuator {actuator}?")
            volts = driver.regulate(level, AVERAGE_S).volts[:, actuator - 1]
            readings[actuator].append((float(volts.mean()), gauge(driver, actuator - 1)))
    return readings


def sensor_section(
    config: RigConfig, actuator: int, readings: Floats, gauge_std_bar: float
) -> calibration_schema.SensorCalibration:
    """The scale of one sensor from readings (n, 2): volts, and the gauge [Pa]."""
    sensor = next(s for s in config.sensors if s.actuator == actuator)
    low, high = sorted(sensor.span_V)
    # At the ends of its span a sensor may have stopped following.
    inside = (readings[:, 0] > low + _CLIPPED_V) & (readings[:, 0] < high - _CLIPPED_V)
    try:
        found: SensorFit = fit_sensor(readings[inside, 0], readings[inside, 1], gauge_std_bar * PA_PER_BAR)
    except CalibrationError as error:
        raise CalibrationError(f"sensor of actuator {actuator}: {error}") from None
    return calibration_schema.SensorCalibration(
        actuator=actuator,
        card=file_sections.card_of(config, sensor.card),
        channel=sensor.channel,
        span_V=sensor.span_V,
        scale_bar_per_V=rounded(found.scale_pa_per_v / PA_PER_BAR, 8),
        offset_bar=rounded(found.offset_pa / PA_PER_BAR, 8),
        covariance=file_sections.matrix(found.covariance / PA_PER_BAR**2),
        rms_bar=rounded(float(np.sqrt(np.mean(found.residuals_pa**2))) / PA_PER_BAR, 4),
        levels=tuple(
            calibration_schema.GaugeLevel(
                volts_V=rounded(v), gauge_bar=rounded(g / PA_PER_BAR), residual_bar=rounded(r / PA_PER_BAR, 4)
            )
            for (v, g), r in zip(readings[inside], found.residuals_pa, strict=True)
        ),
    )


def sweep(config: RigConfig, driver: BenchDriver, index: int) -> list[PressureRate]:
    """Open one valve to more and more voltages, either side, out and back; watch how fast the pressure moves."""
    valve = config.valves[index]
    assert isinstance(valve, FlowValve)
    highest = config.limits.pressure_bar * PA_PER_BAR
    chambers = [a - 1 for a in valve.actuators]

    def reach(share: float) -> None:
        """Regulate to a pressure, then close the valve and let the spool come to rest."""
        level = np.zeros(config.actuators)
        level[chambers] = share * highest
        driver.regulate(level, REACH_S)
        driver.let(index, 0.0, REST_S)

    def watch(offset_v: float, outward: bool, seconds: float) -> PressureRate:
        log = driver.let(index, offset_v, seconds, BAND * highest)
        return rate_of(log.time_s, log.pressure_pa[:, chambers].mean(axis=1), offset_v, outward)

    rates: list[PressureRate] = []
    for share in (FILL_FROM, VENT_FROM):
        reach(share)
        rates.append(watch(0.0, True, LEAK_S))
    limit = FASTEST_SHARE * RateInterlock.of(config, config.sensors[0]).limit_pa_s
    going = {1.0: True, -1.0: True}
    fastest = {1.0: (0.0, 0.0), -1.0: (0.0, 0.0)}
    room_v = min(valve.closed_V - valve.range_V[0], valve.range_V[1] - valve.closed_V) - KICK_V
    for offset in (float(v) for v in OFFSETS_V if v <= room_v):
        for side, share in ((1.0, FILL_FROM), (-1.0, VENT_FROM)):
            if not going[side]:
                continue
            reach(share)
            out = watch(side * offset, True, WATCH_S)
            driver.let(index, side * (offset + KICK_V), KICK_S, BAND * highest)
            back = watch(side * offset, False, WATCH_S)
            rates += [out, back]
            before_v, before = fastest[side]
            now = max(abs(out.rate_pa_s), abs(back.rate_pa_s))
            slope = (now - before) / (offset - before_v)
            fastest[side] = offset, now
            # The next voltage, with a curve that grows steeper, must stay clear of the interlock.
            going[side] = now + 1.6 * slope * 0.1 < limit
    driver.regulate(np.zeros(config.actuators), SETTLE_S)
    return rates


def rate_of(time_s: Floats, pressure_pa: Floats, offset_v: float, outward: bool) -> PressureRate:
    """The line through what a pressure (n,) did, without its beginning, when the spool was still on its way.

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
    return PressureRate(offset_v, outward, mean, rate, math.sqrt(float(rest @ rest) / (len(rest) - 2) / spread))


def volume_m3(config: RigConfig, chambers: list[int], rest_m3: float, pressure_pa: float, arm: Arm) -> float:
    """Air of some chambers as a rate of pressure sees it: a chamber that lengthens with its pressure takes in more."""
    step = 0.05 * config.limits.pressure_bar * PA_PER_BAR
    bore_m2 = math.pi * (config.arm.geometry.inner_radius_mm * 1e-3) ** 2
    volumes = []
    for at in (0.0, pressure_pa - step, pressure_pa + step):
        pressures = np.zeros(config.actuators)
        pressures[chambers] = max(at, 0.0)
        volumes.append(bore_m2 * float(statics(arm, pressures).actuator_lengths_m[chambers].sum()))
    rest, below, above = volumes
    grown = (below + above) / 2 - rest
    return rest_m3 + grown + (pressure_pa + ATMOSPHERE_PA) * (above - below) / (2 * step)


def valve_section(
    config: RigConfig, index: int, rates: list[PressureRate], volume_ml: float, volume_std_ml: float
) -> calibration_schema.ValveCalibration:
    """One valve from its rates; `volume_ml` is one chamber's with its tube."""
    valve = config.valves[index]
    assert isinstance(valve, FlowValve)
    chambers = [a - 1 for a in valve.actuators]
    count, arm = len(chambers), model_arm(config)
    volumes = [volume_m3(config, chambers, count * volume_ml * 1e-6, r.pressure_pa, arm) for r in rates]
    found = fit(valve, valve.fill_sign, rates, volumes)
    return _valve_section(config, index, found, volume_ml * count, volume_std_ml * count)


def _valve_section(
    config: RigConfig, index: int, found: FittedValve, volume_ml: float, volume_std_ml: float
) -> calibration_schema.ValveCalibration:
    valve = config.valves[index]
    assert isinstance(valve, FlowValve)
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
        supply_bar=valve.supply_bar,
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


def _true_gauge(plant: Plant, request: PressureCalibrationRequest, tell: Callable[[str], None]) -> Gauge:
    """Return a simulated gauge: the true pressure plus noise of the gauge's stated uncertainty."""
    rng = np.random.default_rng([request.seed, 0x6A06E])

    def read(_: BenchDriver, actuator: int) -> float:
        value = float(plant.pressure_pa[actuator]) + rng.normal(0, request.gauge_std_bar * PA_PER_BAR)
        tell(f"(simulated gauge) {value / PA_PER_BAR:.4f} bar")
        return value

    return read


def _typed_gauge(keys: Keyboard, tell: Callable[[str], None]) -> Gauge:
    """Return a gauge that the operator reads and types in bar while the pressures are held."""
    typed = ""

    def read(driver: BenchDriver, actuator: int) -> float:
        nonlocal typed
        held = driver.pressure_pa.mean()
        level = np.full(len(driver.pressure_pa), held)
        tell("type the reading in bar, then Enter")
        while True:

            def entered() -> bool:
                nonlocal typed
                typed += keys.pressed()
                return "\n" in typed or "\r" in typed

            driver.regulate(level, 1.0, entered)
            if keys.ended and "\n" not in typed:
                raise StoppedError("no gauge readings: standard input has ended; use --readings")
            if "\n" in typed or "\r" in typed:
                line, _, typed = typed.replace("\r", "\n").partition("\n")
                try:
                    return float(line.strip().replace(",", ".")) * PA_PER_BAR
                except ValueError:
                    tell(f"'{line.strip()}' is not a number; type the reading in bar, such as 0.352")

    return read


def _from_readings(
    config: RigConfig, path: Path, gauge_std_bar: float
) -> tuple[calibration_schema.SensorCalibration, ...]:
    """Sensors' scales from a CSV: actuator, volts_V, gauge_bar."""
    problems: list[Problem] = []
    found: dict[int, list[tuple[float, float]]] = {}
    known = {sensor.actuator for sensor in config.sensors}
    for line, row in control_points.table(path, ("actuator", "volts_V", "gauge_bar")):
        volts = control_points.number(path, line, "volts_V", row["volts_V"], problems)
        gauge = control_points.number(path, line, "gauge_bar", row["gauge_bar"], problems)
        if gauge < VACUUM_BAR:
            expected = f"a gauge pressure above vacuum, {VACUUM_BAR:.3f} bar or more"
            problems.append(Problem(str(path), line, 0, "gauge_bar", row["gauge_bar"], expected))
        text = row["actuator"]
        if not (text.isdecimal() and int(text) in known):
            expected = f"an actuator of rig {config.name}: {', '.join(map(str, sorted(known)))}"
            problems.append(Problem(str(path), line, 0, "actuator", text or "nothing", expected))
            continue
        found.setdefault(int(text), []).append((volts, gauge * PA_PER_BAR))
    if problems:
        raise BadInputError(problems)
    return tuple(sensor_section(config, a, np.array(pairs), gauge_std_bar) for a, pairs in sorted(found.items()))
