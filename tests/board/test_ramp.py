"""The paper's ramp at the rate of the rig `pci1716`, through the board's driver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import runs
from rig.config.loader import load
from rig.hardware.safe_state import SafeOutputs
from runs.records import Status
from runs.run import Run
from tests.board.board_run import OUT_V, emulated_rig
from tests.board.monitor import Monitor
from tests.hardware import forked_run

LEVELS_BAR = np.arange(0.15, 0.651, 0.05)
RAMP_S, DWELL_S = 2.0, 4.0
RATE_HZ = 200.0
REGULATED_BAR = 0.003


def settled_bar(run: Run) -> NDArray[np.float64]:
    """Mean measured pressure of actuator 1 in the last half of each level of the staircase."""
    t_s, ends_s = run.pressure.protocol_s, RAMP_S + DWELL_S * np.arange(1, len(LEVELS_BAR) + 1)
    halves = [(t_s > end - DWELL_S / 2) & (t_s < end) for end in ends_s]
    return np.array([run.pressure.measured_bar[half, 0].mean() for half in halves])


@pytest.mark.usefixtures("kernels")
def test_ramp_a_regulates_the_simulated_chambers_at_the_rate_of_the_rig(bench: Monitor, tmp_path: Path) -> None:
    rig_file = emulated_rig(tmp_path)
    process = forked_run.run(rig_file, "ramp-a", tmp_path / "runs")
    said = process.communicate(timeout=7200)[0].decode()
    print(said)
    assert process.returncode == 0
    assert "emulated board" in said
    (archive,) = (tmp_path / "runs").glob("*.h5")
    run = runs.open(archive)
    assert run.header.simulated
    assert run.status == Status.FINISHED
    assert run.header.control_hz == RATE_HZ
    np.testing.assert_allclose(settled_bar(run), LEVELS_BAR, atol=REGULATED_BAR)
    vent_output = SafeOutputs.of(load(rig_file).valves).held.tolist()
    np.testing.assert_allclose(bench.outputs_v, vent_output, atol=OUT_V)
