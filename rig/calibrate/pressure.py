"""Calibration of the pressures: sensors against a reference gauge, valves by a voltage sweep."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from protocols.problems import bad_input
from rig.calibrate.bench_driver import BenchDriver
from rig.calibrate.bench_operator import BenchOperator
from rig.calibrate.bench_session import real, virtual
from rig.calibrate.file_sections import OutputFile, origin
from rig.calibrate.sensor_scale import Gauge, from_readings, read_gauge, sensor_section, simulated_gauge, typed_gauge
from rig.calibrate.valve_fit import RateMeasurement
from rig.calibrate.valve_sweep import sweep, valve_section
from rig.config import calibration_schema
from rig.config.calibration_files import sha256_of
from rig.config.loader import load, path_of
from rig.config.schema import RigConfig
from rig.execution.plan import StoppedError, require_mocks
from rig.execution.stop_signals import StopSignals
from rig.hardware.lock import cards_locked
from rig.realtime.scheduling import obtainable
from rig.realtime.timing_limits import timing_limits
from rig.simulator.plant_launcher import own_devices, simulated
from rig.valves.metering import MeteringValve

_LARGEST_ML = 1e5
_VOLUME_DOUBT = 0.1

Measured = tuple[dict[int, list[tuple[float, float]]], dict[int, list[RateMeasurement]]]
"""Volts and gauge [Pa] at each level by actuator, and rates by the index of the valve."""


@dataclass(frozen=True)
class PressureCalibrationRequest:
    """Options of the procedure, all as the command gives them."""

    rig: str
    readings: Path | None
    sensors: bool
    valves: bool
    fast: bool
    gauge: str
    gauge_std_bar: float
    volume_ml: float | None
    volume_std_ml: float | None
    yes: bool
    seed: int
    output: OutputFile

    @property
    def by_gauge(self) -> bool:
        """Whether the sensors are read beside the gauge, on the bench."""
        return self.sensors and self.readings is None


@dataclass(frozen=True)
class PressureCalibration:
    """The content of the file, where it is, and the rig."""

    content: calibration_schema.PressureFile
    file: Path
    config: RigConfig


def run(request: PressureCalibrationRequest, operator: BenchOperator) -> PressureCalibration:
    """Calibrate, and write the file.

    Raises:
        BadInputError: the options, the rig or the readings are invalid, or the operator does not arm the bench.
        CardError, StartError: the bench cannot be driven.
        TrippedError: an interlock tripped; StoppedError: the operator stopped it. The valves are safe.
        CalibrationError: the measurements do not determine the parameters.
    """
    config = load(request.rig)
    request.output.check()
    _check(request)
    if request.fast:
        require_mocks(config.name, config.cards)
    sensors: tuple[calibration_schema.SensorCalibration, ...] = ()
    valves: tuple[calibration_schema.ValveCalibration, ...] = ()
    used: tuple[calibration_schema.SourceFileSection, ...] = ()
    if request.readings is not None:
        sensors = from_readings(config, request.readings, request.gauge_std_bar)
        used = (calibration_schema.SourceFileSection(name=request.readings.name, sha256=sha256_of(request.readings)),)
    if request.by_gauge or request.valves:
        if not request.yes and not operator.confirm():
            raise bad_input("--yes", "", "consent: pressures will rise; not armed")
        readings, rates = _measure(request, config, operator)
        # The bench is safe: what takes time comes now.
        for actuator, pairs in sorted(readings.items()):
            sensors += (sensor_section(config, actuator, np.array(pairs), request.gauge_std_bar),)
        volume_ml = request.volume_ml or config.control.volume_ml
        std_ml = _VOLUME_DOUBT * volume_ml if request.volume_std_ml is None else request.volume_std_ml
        valves = tuple(valve_section(config, i, swept, volume_ml, std_ml) for i, swept in rates.items())
    if not (sensors or valves):
        raise bad_input("--no-sensors", "", "something to calibrate: sensors, or a valve that meters flow")
    content = calibration_schema.PressureFile(
        **origin(request.output.note),
        kind="pressure",
        gauge=request.gauge,
        gauge_std_bar=request.gauge_std_bar,
        sensors=sensors,
        valves=valves,
        sources=used,
    )
    return PressureCalibration(
        content, request.output.write(content, request.output.path(f"pressure-{config.name}")), config
    )


def _check(request: PressureCalibrationRequest) -> None:
    if not 0 < request.gauge_std_bar < 1:
        raise bad_input(
            "--gauge-std-bar", f"{request.gauge_std_bar:g}", "the gauge's standard uncertainty in bar, more than 0"
        )
    for option, value in (("--volume-ml", request.volume_ml), ("--volume-std-ml", request.volume_std_ml)):
        if value is not None and not 0 < value < _LARGEST_ML:
            raise bad_input(option, f"{value:g}", f"millilitres, more than 0 and less than {_LARGEST_ML:g}")


def _measure(request: PressureCalibrationRequest, config: RigConfig, operator: BenchOperator) -> Measured:
    """Drive the bench in virtual or real time; it is safe afterwards, however this ends."""
    with StopSignals() as stop:
        if request.fast:
            with virtual(config, request.seed) as (bench, clock, plant):
                driver = BenchDriver(config, bench, clock, lambda: _raise_if_stopped(stop))
                gauge = simulated_gauge(plant, request.gauge_std_bar, request.seed, operator.tell)
                return _drive(request, config, driver, gauge, operator)
        rig_file = path_of(request.rig)
        timing = timing_limits(config, obtainable())
        with (
            own_devices(config) as config,
            cards_locked(config, "rig calibrate pressure"),
            simulated(config, rig_file, request.seed, timing.simulation_waits_ns),
            operator.keys() as keys,
            real(config, rig_file) as (held, clock),
        ):
            stops_ns = timing.simulator_ns
            driver = BenchDriver(config, held, clock, lambda: _raise_if_stopped(stop), longest_stop_ns=stops_ns)
            return _drive(request, config, driver, typed_gauge(keys, operator.tell), operator)


def _raise_if_stopped(stop: StopSignals) -> None:
    if stop.reason:
        raise StoppedError(f"stopped: {stop.reason}; the valves go to their safe state")


def _drive(
    request: PressureCalibrationRequest, config: RigConfig, driver: BenchDriver, gauge: Gauge, operator: BenchOperator
) -> Measured:
    readings = read_gauge(config, driver, gauge, operator.tell) if request.by_gauge else {}
    rates = {}
    for index, valve in enumerate(config.valves) if request.valves else ():
        if isinstance(valve, MeteringValve):
            operator.tell(f"valve {index + 1}: sweep of its voltage")
            rates[index] = sweep(config, driver, index)
    return readings, rates
