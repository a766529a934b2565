"""In real time: who survives makes the bench safe, `rig vent` ends a run that goes, nobody waits for a terminal."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from rig_process import rig_run

import runs
from runs.records import Status
from scripts.faults import realtime
from scripts.faults.catalogue import CATALOGUE

pytestmark = pytest.mark.alone

SOME = ("all but the observer killed", "all but the observer stopped, 4 s", "terminal blocked (Ctrl-S, a full pipe)")


@pytest.mark.parametrize("name", SOME)
def test_the_fault_is_told_and_the_bench_is_safe(name: str, tmp_path: Path) -> None:
    (fault,) = (fault for fault in CATALOGUE if fault.name == name)
    trial = realtime.trial(fault, tmp_path, at_s=1.0, seed=1)
    assert trial.wrong == ""


def test_rig_vent_ends_a_run_that_goes(tmp_path: Path) -> None:
    with rig_run(tmp_path) as run:
        run.wait_until_pressurised()
        vent = [sys.executable, "-m", "rig", "vent", "--rig", str(run.rig_file)]
        subprocess.run(vent, check=True, capture_output=True)
        run.wait_until_safe(1.0)
        assert run.end() == 1, run.output
    archive = runs.open(run.archive())
    assert archive.status is Status.ABORTED
    assert "another program has written to the card" in archive.message
