"""The bench driver of a calibration when its computer is busy."""

from __future__ import annotations

from itertools import cycle

import numpy as np

from rig.calibrate.bench_driver import BenchDriver
from rig.calibrate.bench_session import virtual
from rig.simulator.plant import Plant
from tests.support.plant_bench import mock_rig


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
