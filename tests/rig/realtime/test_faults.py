"""Faults injected into real-time runs: any surviving process makes the bench safe, and none waits for a terminal."""

from __future__ import annotations

from pathlib import Path

import pytest

import runs
from rig.hardware.safe_state import UNSAFE
from runs.records import Status
from scripts.faults import realtime
from scripts.faults.catalogue import CATALOGUE, FOR_EVER
from scripts.faults.injections import KILL
from scripts.faults.trial_run import CONTROL, TrialRun

pytestmark = pytest.mark.realtime

SOME = ("all but the observer stopped, 4 s", "terminal blocked (Ctrl-S, a full pipe)")


@pytest.mark.parametrize("name", SOME)
def test_the_fault_is_reported_and_the_bench_is_safe(name: str, tmp_path: Path) -> None:
    trial = realtime.trial(CATALOGUE[name], tmp_path, at_s=1.0, seed=1)
    assert trial.wrong == ""


@pytest.mark.parametrize("killed", [(), (CONTROL,)], ids=["by control", "by the watchdog"])
def test_valves_that_cannot_be_written_are_never_called_safe(killed: tuple[str, ...], tmp_path: Path) -> None:
    run = TrialRun(tmp_path)
    try:
        registers = run.wait_until_moving()
        registers.faults.inject(failing_writes=FOR_EVER)
        run.signal(killed, KILL)
        assert run.process.wait(20) == 1
        registers.close()
    finally:
        run.close()
    archive = runs.open(next(run.out.glob("*.h5")))
    assert archive.status is Status.ABORTED
    assert UNSAFE in archive.message
    assert not any("the valves are in their safe state" in event.message for event in archive.events)
