"""The emulated board with the simulator behind it: its valves, chambers and sensors answer to the registers."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config.loader import load
from tests.board.conftest import OpenBoard, reload_driver
from tests.board.monitor import Monitor
from tests.hardware import forked_run

CLOSED_V = 5.0
FILLING_V = 5.8
SECTIONS_OF_A_CAMERA = re.compile(r"^(cameras|board|control|limits):.*?(?=^\S|\Z)", re.MULTILINE | re.DOTALL)
SLOW = """
limits: {pressure_bar: 0.7, rate_bar_per_s: 1.0, rate_margin_bar_per_s: 1000, tracking_bar: 0.05, tracking_s: 10,
  frozen_s: 30, stale_s: 5, no_tip_s: 30, hung_s: 5}
control: {rate_hz: 20, bandwidth_hz: 1, integral_s: 1, volume_ml: 60}
"""
"""An emulated processor is too slow for 200 Hz."""
PROTOCOL = """
title: One step behind the emulated board
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 6, shape: smooth}
  - hold: {duration_s: 10}
  - ramp: {actuators: [1], to_bar: 0, duration_s: 6, shape: smooth}
"""


@pytest.fixture
def bench(monitor: Monitor) -> Iterator[Monitor]:
    """The board with the simulator behind it."""
    monitor.set("coupled", value=True)
    yield monitor
    monitor.set("coupled", value=False)


def until(condition: Callable[[], bool], what: str, patience_s: float = 30.0) -> None:
    end = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.02)


def test_loading_the_driver_vents_a_chamber_under_pressure(bench: Monitor, open_board: OpenBoard) -> None:
    """Loading writes 0 V, at which the valve opens its exhaust."""
    card = open_board((0, 1), acquisition="instruction")
    card.start()

    def sensor_v() -> float:
        return float(card.read().volts[0, 0])

    vented_v = sensor_v()
    card.write(np.array([FILLING_V, CLOSED_V]))
    until(lambda: sensor_v() > vented_v + 0.15, "the chamber does not fill")
    card.write(np.array([CLOSED_V, CLOSED_V]))
    card.close()
    reload_driver()
    assert bench.outputs_v == [0.0, 0.0]
    card = open_board((0, 1), acquisition="instruction")
    card.start()
    until(lambda: sensor_v() < vented_v + 0.05, "the chamber does not vent")


def test_a_run_regulates_the_simulated_chambers_through_the_driver(bench: Monitor, tmp_path: Path) -> None:
    stated = (Path(forked_run.__file__).parents[2] / "rig/rigs/pci1716.yaml").read_text()
    text = SECTIONS_OF_A_CAMERA.sub("", stated).replace("driver: comedi,", "driver: comedi, emulated: true,") + SLOW
    rig_file, protocol = tmp_path / "emulated.yaml", tmp_path / "step.yaml"
    rig_file.write_text(text)
    protocol.write_text(PROTOCOL)
    process = forked_run.run(str(rig_file), str(protocol), tmp_path / "runs")
    said, _ = process.communicate(timeout=600)
    assert process.returncode == 0, said.decode()
    (archive,) = (tmp_path / "runs").glob("*.h5")
    run = runs.open(archive)
    assert "emulated board" in said.decode()
    assert run.header.simulated
    held = (run.pressure.protocol_s > 12) & (run.pressure.protocol_s < 15)
    assert held.any()
    np.testing.assert_allclose(run.pressure.measured_bar[held, 0], 0.3, atol=0.03)
    vent_v = [valve.safe_v(vent=False) for valve in load(str(rig_file)).valves]
    np.testing.assert_allclose(bench.outputs_v, vent_v, atol=0.01)
