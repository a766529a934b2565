"""Short memory or an interrupted start gives one sentence and an exit status, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from rig.hardware import runtime_folder
from rig.hardware.cards.base import CardError
from rig.simulator import registers
from scripts.faults import environment
from scripts.faults.environment import UnsupportedFaultError
from scripts.rig_process import BRIEF, child_of, rig_run

SIMULATOR = "rig.simulator.plant_process"


def test_a_mock_card_for_which_there_is_no_room_is_refused_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path)
    try:
        with environment.small_disk(tmp_path):
            runtime_folder.runtime_folder()
            environment.fill(tmp_path)
            with pytest.raises(CardError, match="No space left on device"):
                registers.Registers.create("roomy", 2, 8)
            assert not registers.path_of("roomy").exists()
    except UnsupportedFaultError as why:
        pytest.skip(str(why))


@pytest.mark.realtime
def test_a_supervisor_killed_while_the_simulator_loads_leaves_no_traceback_and_no_process(tmp_path: Path) -> None:
    with rig_run(tmp_path, BRIEF) as run:
        deadline = time.monotonic() + 60
        plant = 0
        while not plant:
            assert time.monotonic() < deadline, run.output
            try:
                plant = child_of(run.process.pid, SIMULATOR)
            except AssertionError:
                time.sleep(0.005)
        os.kill(run.process.pid, signal.SIGKILL)
        run.process.wait()
        while Path(f"/proc/{plant}").exists():
            assert time.monotonic() < deadline, run.output
            time.sleep(0.02)
        assert "Traceback" not in run.output
