"""A closed loop in virtual time for the tests of control and plant: regulator, bench and plant, nothing else."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import rig
from model.arrays import Array
from rig.config.schema import RigConfig
from rig.control import step as control
from rig.hardware.bench import Bench
from rig.simulator.plant import Plant

Setpoint = Callable[[float], tuple[Array, Array]]
Disturb = Callable[[float, Plant, Array], Array]

BEGIN_NS = 100_000_000
MOCK = Path(rig.__file__).parent / "rigs" / "mock-ideal.yaml"


def mock_rig(**changes: object) -> RigConfig:
    """The rig mock-ideal with changed values; `simulator__valve__leakage_l_min=7` changes a nested one."""
    data: dict[str, Any] = copy.deepcopy(yaml.safe_load(MOCK.read_text()))
    for key, value in changes.items():
        *way, last = key.split("__")
        place: Any = data
        for step in way:
            place = place[int(step)] if step.isdigit() else place[step]
        place[int(last) if last.isdigit() else last] = value
    return RigConfig.model_validate(data)


class Played:
    """What a closed loop did: columns over cycles; `true_pa` comes from the plant, `measured_pa` from the sensors."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.t_s: list[float] = []
        self.rows: list[tuple[Array, Array, Array, Array]] = []
        self.trip: control.Trip | None = None

    @property
    def time(self) -> Array:
        return np.array(self.t_s)

    def column(self, which: int) -> Array:
        return np.array([row[which] for row in self.rows])

    @property
    def setpoint_pa(self) -> Array:
        return self.column(0)

    @property
    def true_pa(self) -> Array:
        return self.column(1)

    @property
    def measured_pa(self) -> Array:
        return self.column(2)

    @property
    def outputs(self) -> Array:
        return self.column(3)


def play(
    config: RigConfig,
    setpoint: Setpoint,
    duration_s: float,
    *,
    seed: int = 1,
    moving_arm: bool = False,
    disturb: Disturb | None = None,
) -> Played:
    """Run the regulator against the plant. `disturb(t, plant, volts (n, N))` may change the plant or the readings."""
    plant = Plant(config, seed, 0, moving_arm=moving_arm)
    bench = Bench(config, {name: plant.card(name) for name in config.cards}, lambda: plant.t_ns)
    bench.safe_state.arm()
    bench.start()
    plant.advance(BEGIN_NS)
    settings = control.prepare(config)
    state = control.initial(settings)
    sensors = sorted(config.sensors, key=lambda s: s.actuator)
    period_ns = round(1e9 / config.control.rate_hz)
    played = Played(period_ns * 1e-9)
    for cycle in range(round(duration_s * 1e9) // period_ns):
        t_s = cycle * period_ns * 1e-9
        now = BEGIN_NS + cycle * period_ns
        plant.advance(now)
        scans = bench.read()
        volts = disturb(t_s, plant, scans.signals) if disturb else scans.signals
        pressure = np.column_stack([s.pressure_pa(volts[:, i]) for i, s in enumerate(sensors)]).mean(axis=0)
        target, rate = setpoint(t_s)
        sample = control.Sample(now, int(scans.t_ns[-1]), volts[-1], pressure)
        state, command = control.step(settings, state, sample, target, rate)
        if command.trip is not None:
            played.trip = command.trip
            break
        bench.write(command.outputs)
        played.t_s.append(t_s)
        played.rows.append((target, plant.pressure_pa, pressure, command.outputs))
    return played


def staircase(levels_bar: list[float], dwell_s: float, actuators: list[int]) -> Setpoint:
    """Consecutive levels on some actuators (counted from 0), zero on the others."""

    def setpoint(t_s: float) -> tuple[Array, Array]:
        target = np.zeros(3)
        target[actuators] = levels_bar[min(int(t_s / dwell_s + 1e-9), len(levels_bar) - 1)] * 1e5
        return target, np.zeros(3)

    return setpoint


def sinusoid(actuators: list[int]) -> Setpoint:
    """The paper's 0.35 + 0.25 sin(t + 4 pi/3) bar."""

    def setpoint(t_s: float) -> tuple[Array, Array]:
        target, rate = np.zeros(3), np.zeros(3)
        target[actuators] = (0.35 + 0.25 * np.sin(t_s + 4 * np.pi / 3)) * 1e5
        rate[actuators] = 0.25 * np.cos(t_s + 4 * np.pi / 3) * 1e5
        return target, rate

    return setpoint


def steps_of(played: Played, pressure_pa: Array, levels_bar: list[float], dwell_s: float) -> list[tuple[float, float]]:
    """For every level after the first: seconds until it stays within 0.01 bar, and the overshoot [bar]."""
    out = []
    for i in range(1, len(levels_bar)):
        during = (played.time >= i * dwell_s - 1e-9) & (played.time < (i + 1) * dwell_s - 1e-9)
        since = played.time[during] - i * dwell_s
        error = pressure_pa[during] / 1e5 - levels_bar[i]
        outside = since[np.abs(error) > 0.01]
        settled = float(outside.max()) + played.period_s if len(outside) else 0.0
        out.append((settled, float((error * np.sign(levels_bar[i] - levels_bar[i - 1])).max())))
    return out
