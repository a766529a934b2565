"""Scales of pressure sensors against a reference gauge: typed, simulated, or from a CSV of readings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration.camera import CalibrationError
from calibration.pressure import SensorFit, fit_sensor
from model.arrays import Array
from model.units import PA_PER_BAR
from protocols import Problem
from protocols.problems import raise_all
from rig.calibrate import file_sections, inputs
from rig.calibrate.bench_driver import BenchDriver
from rig.calibrate.bench_operator import Keys
from rig.config import calibration_schema
from rig.config.calibration_files import rounded
from rig.config.schema import RigConfig
from rig.execution.plan import StoppedError
from rig.simulator.plant import Plant
from rig.valves.iso6358 import ATMOSPHERE_PA

Gauge = Callable[[BenchDriver, int], float]
"""Reads the reference gauge [Pa] at the chamber of an actuator (from 0) while the driver regulates."""

LEVELS = (0.15, 0.35, 0.55, 0.75, 0.95)
"""Levels as shares of the highest set-point."""
SETTLE_S, AVERAGE_S = 1.2, 0.5
VACUUM_BAR = -ATMOSPHERE_PA / PA_PER_BAR
_CLIPPED_V = 0.004
_GAUGE_SEED = 0x6A06E


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
            volts = driver.regulate(level, AVERAGE_S).signals[:, actuator - 1]
            readings[actuator].append((float(volts.mean()), gauge(driver, actuator - 1)))
    return readings


def sensor_section(
    config: RigConfig, actuator: int, readings: Array, gauge_std_bar: float
) -> calibration_schema.SensorCalibration:
    """The scale of one sensor from readings (n, 2): volts, and the gauge [Pa]."""
    sensor = next(s for s in config.sensors if s.actuator == actuator)
    if sensor.unit != "V":
        raise CalibrationError(
            f"sensor of actuator {actuator}: it gives {sensor.unit}, so there is no voltage to scale"
        )
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


def simulated_gauge(plant: Plant, std_bar: float, seed: int, tell: Callable[[str], None]) -> Gauge:
    """Return a simulated gauge: the true pressure plus noise of the gauge's stated uncertainty."""
    rng = np.random.default_rng([seed, _GAUGE_SEED])

    def read(_: BenchDriver, actuator: int) -> float:
        value = float(plant.pressure_pa[actuator]) + rng.normal(0, std_bar * PA_PER_BAR)
        tell(f"(simulated gauge) {value / PA_PER_BAR:.4f} bar")
        return value

    return read


def typed_gauge(keys: Keys, tell: Callable[[str], None]) -> Gauge:
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


def from_readings(
    config: RigConfig, path: Path, gauge_std_bar: float
) -> tuple[calibration_schema.SensorCalibration, ...]:
    """Return the scales of the sensors from a CSV: actuator, volts_V, gauge_bar.

    Raises:
        BadInputError: a cell is invalid. CalibrationError: the readings do not determine a scale.
    """
    problems: list[Problem] = []
    found: dict[int, list[tuple[float, float]]] = {}
    known = {sensor.actuator for sensor in config.sensors}
    for line, row in inputs.table(path, ("actuator", "volts_V", "gauge_bar")):
        volts = inputs.number(path, line, "volts_V", row["volts_V"], problems)
        gauge = inputs.number(path, line, "gauge_bar", row["gauge_bar"], problems)
        if gauge < VACUUM_BAR:
            expected = f"a gauge pressure above vacuum, {VACUUM_BAR:.3f} bar or more"
            problems.append(Problem(str(path), line, 0, "gauge_bar", row["gauge_bar"], expected))
        text = row["actuator"]
        if not (text.isdecimal() and int(text) in known):
            expected = f"an actuator of rig {config.name}: {', '.join(map(str, sorted(known)))}"
            problems.append(Problem(str(path), line, 0, "actuator", text or "nothing", expected))
            continue
        found.setdefault(int(text), []).append((volts, gauge * PA_PER_BAR))
    raise_all(problems)
    return tuple(sensor_section(config, a, np.array(pairs), gauge_std_bar) for a, pairs in sorted(found.items()))
