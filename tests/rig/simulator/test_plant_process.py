"""The time of the simulated bench when its computer is busy."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import rig.config.loader
from rig.control.control_loop import ControlLoop
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.hardware.bench import open_bench
from rig.simulator.plant import Plant
from rig.simulator.plant_process import SimulatedCard, advance_while_driven
from rig.simulator.registers import path_of

MS = 1_000_000
WAITS_NS = 15 * MS


class Clock:
    """A monotonic clock that the test moves."""

    now_ns = 10**12

    def __call__(self) -> int:
        return self.now_ns


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(time, "monotonic_ns", clock)
    return clock


@pytest.fixture
def device() -> Iterator[str]:
    name = f"busy-{os.getpid()}"
    yield name
    path_of(name).unlink(missing_ok=True)


@pytest.mark.parametrize("every_ms", [16, 18, 40, 300])
def test_a_plant_that_runs_too_seldom_simulates_the_allowed_wait_before_the_present(
    clock: Clock, device: str, every_ms: int
) -> None:
    config = rig.config.loader.parse(
        rig.config.loader.text("mock").replace("device: mock0", f"device: {device}"), "rig.yaml"
    )
    plant = Plant(config, 1, clock.now_ns, moving_arm=False)
    card = SimulatedCard(config, next(iter(config.cards)), plant)
    for _ in range(20):
        clock.now_ns += every_ms * MS
        card.registers.outputs["value"][:] = 8.0
        card.registers.outputs["written_ns"][:] = clock.now_ns - 1 * MS
        advance_while_driven(plant, [card], WAITS_NS)
        assert plant.t_ns == clock.now_ns
    assert card.registers.scans_written >= 20 * WAITS_NS // MS


def test_pressures_are_regulated_where_control_and_plant_run_seldom(clock: Clock, device: str, tmp_path: Path) -> None:
    """Each waits so long for a processor that the other has long stopped: only the time of the bench counts."""
    rig_file, protocol = tmp_path / "rig.yaml", tmp_path / "hold.yaml"
    rig_file.write_text(rig.config.loader.text("mock").replace("device: mock0", f"device: {device}"))
    protocol.write_text(
        "title: hold\nsteps:\n  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 2}\n  - hold: {duration_s: 60}\n"
    )
    plan = prepare(str(protocol), str(rig_file), RunOptions(out=tmp_path, fast=True, seed=1)).plan
    plant = Plant(plan.config, 1, clock.now_ns, moving_arm=False)
    card = SimulatedCard(plan.config, next(iter(plan.config.cards)), plant)
    bench = open_bench(plan.config)
    loop = ControlLoop(plan, bench, time_may_stop=True)
    bench.safe_state.arm()
    bench.start()
    for cycle in range(1000):
        clock.now_ns += 60 * MS
        advance_while_driven(plant, [card], WAITS_NS)
        clock.now_ns += 40 * MS
        _, trip = loop.cycle(cycle, clock.now_ns, 1, 0, False, 95 * MS, 0)
        assert trip is None
    bench.close()
    assert plant.pressure_pa == pytest.approx([0.3e5, 0.0, 0.0], abs=0.02e5)
