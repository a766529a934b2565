"""The bench driver of a calibration when its computer is busy."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from itertools import cycle

import numpy as np
import pytest

from rig.calibrate.bench_driver import BenchDriver, BenchLog
from rig.calibrate.bench_session import virtual
from rig.hardware.bench import Bench, open_bench
from rig.hardware.cards.base import CardError
from rig.simulator.plant import Plant
from rig.simulator.plant_process import SimulatedCard, advance_while_driven
from rig.simulator.registers import path_of
from tests.support.plant_bench import mock_rig

MS = 1_000_000
WAITS_NS = 15 * MS


class LateClock:
    """Control periods in virtual time, some of which begin late."""

    def __init__(self, plant: Plant, period_ns: int, periods: tuple[int, ...]) -> None:
        self._plant, self._period_ns, self._periods = plant, period_ns, cycle(periods)

    def next(self) -> int:
        """Advance the plant to the next period."""
        self._plant.advance(self._plant.t_ns + next(self._periods) * self._period_ns)
        return self._plant.t_ns


def test_late_cycles_change_no_measured_rate() -> None:
    config = mock_rig()
    with virtual(config, 0, moving_arm=False) as (bench, _, plant):
        clock = LateClock(plant, round(1e9 / config.control.rate_hz), (1, 1, 8))
        driver = BenchDriver(config, bench, clock, lambda: None)
        log = driver.open_valve(0, 1.2, 0.15, 0.4e5)
    rate_pa_s = np.polyfit(log.time_s, log.pressure_pa[:, 0], 1)[0]
    assert 0.5e5 < rate_pa_s < 1.5e5


class StarvedClock:
    """Control periods in real time of a simulated bench: plant and driver get a processor once in 100 ms each."""

    def __init__(self, plant: Plant, card: SimulatedCard, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns = plant.t_ns
        self.plant_runs, self.turns_missed = True, 0
        self._plant, self._card = plant, card
        monkeypatch.setattr(time, "monotonic_ns", lambda: self.now_ns)
        advance_while_driven(plant, [card], WAITS_NS)

    def next(self) -> int:
        """Let 100 ms pass, with a turn of the plant in between."""
        self.now_ns += 60 * MS
        self.turns_missed -= 1
        if self.plant_runs and self.turns_missed < 0:
            advance_while_driven(self._plant, [self._card], WAITS_NS)
        self.now_ns += 40 * MS
        return self.now_ns


@pytest.fixture
def starved(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[BenchDriver, StarvedClock, Bench]]:
    name = f"starved-{os.getpid()}"
    config = mock_rig(cards__daq__device=name)
    plant = Plant(config, 1, 10**12, moving_arm=False)
    clock = StarvedClock(plant, SimulatedCard(config, "daq", plant), monkeypatch)
    bench = open_bench(config)
    bench.safe_state.arm()
    bench.start()
    yield BenchDriver(config, bench, clock, lambda: None, longest_stop_ns=1000 * MS), clock, bench
    bench.close()
    path_of(name).unlink(missing_ok=True)


def rising_pa_s(log: BenchLog) -> float:
    """Rate at which the pressure of actuator 1 rises through 0.1 to 0.3 bar."""
    pressure_pa = log.pressure_pa[:, 0]
    rising = (pressure_pa > 0.1e5) & (pressure_pa < 0.3e5)
    return float(np.polyfit(log.time_s[rising], pressure_pa[rising], 1)[0])


def test_pressures_of_a_starved_simulation_are_regulated(starved: tuple[BenchDriver, StarvedClock, Bench]) -> None:
    driver, _, _ = starved
    log = driver.regulate(np.array([0.3e5, 0.0, 0.0]), 2.0)
    assert driver.pressure_pa == pytest.approx([0.3e5, 0.0, 0.0], abs=0.02e5)
    assert log.time_s[-1] == pytest.approx(2.0, abs=0.05)


def test_rates_of_a_starved_simulation_are_those_in_its_own_time(
    starved: tuple[BenchDriver, StarvedClock, Bench],
) -> None:
    driver, _, _ = starved
    config = mock_rig()
    with virtual(config, 0, moving_arm=False) as (bench, clock, _):
        undisturbed = BenchDriver(config, bench, clock, lambda: None).open_valve(0, 1.2, 0.3, 0.4e5)
    log = driver.open_valve(0, 1.2, 0.3, 0.4e5)
    assert rising_pa_s(log) == pytest.approx(rising_pa_s(undisturbed), rel=0.03)


def test_the_first_sample_of_a_starved_simulation_may_be_late(
    starved: tuple[BenchDriver, StarvedClock, Bench],
) -> None:
    driver, clock, _ = starved
    clock.turns_missed = 3
    assert len(driver.regulate(np.zeros(3), 0.1).time_s)


def test_a_simulation_that_stands_still_too_long_ends_the_drive(
    starved: tuple[BenchDriver, StarvedClock, Bench],
) -> None:
    driver, clock, _ = starved
    driver.regulate(np.zeros(3), 0.1)
    clock.plant_runs = False
    with pytest.raises(CardError, match="the simulator has stalled for 1"):
        driver.regulate(np.zeros(3), 0.1)
