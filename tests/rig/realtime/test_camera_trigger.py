"""A card triggers the camera of a real-time run: frames have the times of pulses, and the output ends low."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.simulator.faults import CameraFault
from rig.simulator.registers import Registers
from runs.records import Status
from scripts.faults.injections import KILL, STOP
from scripts.faults.trial_run import CONTROL, PROTOCOL, SUPERVISOR, WATCHDOG, TrialRun
from tests.support.triggered_bench import CHANNEL, FRAME_NS, triggered

pytestmark = pytest.mark.realtime

DELAY_MS = 12
LIMIT_S = 30.0


def edited(text: str) -> str:
    """A triggered bench whose output is high for most of the time."""
    return triggered(text, stamp_delay_ms=DELAY_MS, trigger=", width_ms: 35")


@pytest.fixture
def run(tmp_path: Path) -> Iterator[TrialRun]:
    run = TrialRun(tmp_path, edit=edited)
    yield run
    run.close()


def while_high(registers: Registers) -> None:
    """Wait for the begin of a pulse."""
    rises, until = registers.rise(CHANNEL)[0], time.monotonic() + LIMIT_S
    while registers.rise(CHANNEL)[0] == rises:
        assert time.monotonic() < until
        time.sleep(0.0005)


def vented(run: TrialRun) -> None:
    """Vent from another process."""
    command = [sys.executable, "-P", "-m", "rig", "vent", "--rig", str(run.rig_file)]
    subprocess.run(command, check=True, capture_output=True)


@pytest.mark.parametrize(
    "strike",
    [
        lambda run: run.signal((CONTROL,), KILL),
        lambda run: run.signal((CONTROL,), STOP),
        lambda run: run.signal((SUPERVISOR,), KILL),
        lambda run: run.signal((SUPERVISOR, CONTROL, WATCHDOG), KILL),
        vented,
    ],
    ids=["control killed", "control stopped", "supervisor killed", "all but the observer killed", "rig vent"],
)
def test_the_trigger_ends_low_however_the_run_ends(run: TrialRun, strike: object) -> None:
    registers = run.wait_until_moving()
    while_high(registers)
    assert callable(strike)
    strike(run)
    assert run.watch(registers) is not None, "the valves are safe"
    rises = registers.rise(CHANNEL)[0]
    assert rises > 10
    assert not registers.digital["high"].any()
    registers.close()


def test_frames_have_the_times_of_pulses_and_what_is_lost_is_reported(tmp_path: Path) -> None:
    # Control may be late for longer than the strict limit of a real bench.
    run = TrialRun(tmp_path, edit=edited, protocol=PROTOCOL.format(moving_s=3.0), limits={"hung_s": 5.0})
    try:
        registers = run.wait_until_moving()
        registers.faults.inject(camera=CameraFault.DROPPING)
        for _ in range(25):
            while_high(registers)
        registers.faults.clear()
        run.signal((CONTROL,), STOP)
        time.sleep(0.2)
        run.signal((CONTROL,), signal.SIGCONT)
        assert run.process.wait(60) == 0, run.output
        registers.close()
    finally:
        run.close()
    archive = runs.open(next(run.out.glob("*.h5")))
    assert archive.status is Status.FINISHED
    trigger, exposure, tip = archive.trigger, archive.exposure, archive.tip
    assert trigger is not None
    assert exposure is not None
    period_s = FRAME_NS * 1e-9
    assert np.diff(trigger.time_s).min() > period_s - 0.005, "no two pulses much closer than a frame period"
    by_number = dict(zip(trigger.pulse.tolist(), trigger.time_s.tolist(), strict=True))
    began_s = [by_number[frame] for frame in tip.frame.tolist() if frame in by_number]
    assert len(began_s) >= len(tip.frame) - 1
    np.testing.assert_allclose(tip.time_s[-len(began_s) :], np.array(began_s) + 0.004, atol=1e-6)
    late_us = np.abs(exposure.stamp_delay_us[-len(began_s) :, 0] - DELAY_MS * 1e3)
    uncertain = dict(zip(trigger.pulse.tolist(), trigger.uncertainty_us.tolist(), strict=True))
    assert np.all(late_us <= np.array([uncertain[frame] for frame in tip.frame[-len(began_s) :].tolist()]) + 1)
    lost = int(trigger.skipped.sum())
    assert lost >= 3
    assert archive.timing.counters["lost_pulses"] == lost
    between = np.diff(tip.frame) - 1
    np.testing.assert_array_equal(tip.dropped[1:], between)
    assert between.max() >= 9
    messages = [event.message for event in archive.events]
    assert any("pulses of the camera trigger were left out: control was late" in message for message in messages)
