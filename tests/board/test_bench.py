"""The emulated board with the simulator behind it: its valves, chambers and sensors answer to the registers."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config.loader import load
from rig.hardware.safe_state import SafeOutputs
from tests.board.board_run import OUT_V, emulated_rig
from tests.board.conftest import OpenBoard, reload_driver
from tests.board.monitor import Monitor
from tests.hardware import forked_run

CLOSED_V = 5.0
FILLING_V = 5.8
PROTOCOL = """
title: One step behind the emulated board
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 6, shape: smooth}
  - hold: {duration_s: 10}
  - ramp: {actuators: [1], to_bar: 0, duration_s: 6, shape: smooth}
"""


def until(condition: Callable[[], bool], what: str, patience_s: float = 30.0) -> None:
    end = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.02)


class Chamber:
    """The first chamber of the bench as a program of the guest sees it: through an input of the board."""

    def __init__(self, open_board: OpenBoard) -> None:
        self.card = open_board((0, 1), acquisition="instruction")
        self.card.start()

    @property
    def sensor_v(self) -> float:
        return float(self.card.read().signals[0, 0])

    def fill(self) -> float:
        """Put it under pressure and close its valve; the sensor's voltage before [V]."""
        vented_v = self.sensor_v
        self.card.write(np.array([FILLING_V, CLOSED_V]))
        until(lambda: self.sensor_v > vented_v + 0.15, "the chamber does not fill")
        self.card.write(np.array([CLOSED_V, CLOSED_V]))
        return vented_v

    def await_vented(self, vented_v: float) -> None:
        until(lambda: self.sensor_v < vented_v + 0.05, "the chamber does not vent")


def test_loading_the_driver_vents_a_chamber_under_pressure(bench: Monitor, open_board: OpenBoard) -> None:
    """Loading writes 0 V, at which the valve opens its exhaust."""
    chamber = Chamber(open_board)
    vented_v = chamber.fill()
    chamber.card.close()
    reload_driver()
    assert bench.outputs_v == [0.0, 0.0]
    Chamber(open_board).await_vented(vented_v)


def test_a_reset_of_the_board_vents_a_chamber_and_the_read_back_does_not_show_it(
    bench: Monitor, open_board: OpenBoard
) -> None:
    """As after a short interruption of its supply; the driver answers a read-back from its memory."""
    chamber = Chamber(open_board)
    vented_v = chamber.fill()
    bench.set("reset", value=True)
    assert bench.outputs_v == [0.0, 0.0]
    np.testing.assert_allclose(chamber.card.readback(), CLOSED_V, atol=OUT_V)
    chamber.await_vented(vented_v)
    chamber.card.write(np.array([CLOSED_V, CLOSED_V]))
    np.testing.assert_allclose(bench.outputs_v, CLOSED_V, atol=OUT_V)


@pytest.mark.usefixtures("kernels")
def test_a_run_regulates_the_simulated_chambers_through_the_driver(bench: Monitor, tmp_path: Path) -> None:
    rig_file, protocol = emulated_rig(tmp_path), tmp_path / "step.yaml"
    protocol.write_text(PROTOCOL)
    process = forked_run.run(rig_file, str(protocol), tmp_path / "runs")
    said, _ = process.communicate(timeout=600)
    assert process.returncode == 0, said.decode()
    (archive,) = (tmp_path / "runs").glob("*.h5")
    run = runs.open(archive)
    assert "emulated board" in said.decode()
    assert run.header.simulated
    held = (run.pressure.protocol_s > 12) & (run.pressure.protocol_s < 15)
    assert held.any()
    np.testing.assert_allclose(run.pressure.measured_bar[held, 0], 0.3, atol=0.03)
    vent_output = SafeOutputs.of(load(rig_file).valves).held.tolist()
    np.testing.assert_allclose(bench.outputs_v, vent_output, atol=OUT_V)
