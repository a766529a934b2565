"""The time of the simulated bench when its computer is busy."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest

import rig.config.loader
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
