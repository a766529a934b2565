"""Runs on the kernel's devices that are struck, as `rig run` but for being forked (see forked_run.py)."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable

from runs.records import Status
from tests.hardware.rig_of_the_machine import Player
from tests.hardware.struck_run import MOVING_V, SHORT_S, Struck


def test_ctrl_c(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGINT, "supervisor")))
    assert "by the operator (Ctrl-C)" in struck.said()
    assert struck.process.returncode == 130
    assert struck.archive().status is Status.INTERRUPTED


def test_the_supervisor_killed(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "supervisor")))
    assert struck.process.wait(SHORT_S) == -signal.SIGKILL
    assert struck.recovered().status is not Status.FINISHED


def test_control_killed(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "control")))
    assert "the control process died" in struck.said()
    assert struck.process.returncode == 1
    run = struck.archive()
    assert (run.status, run.message) == (Status.ABORTED, "the control process died")
    assert run.pressure.measured_bar[:, 0].max() * 10 > MOVING_V


def test_the_observer_killed(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "observer")))
    assert "the observer process died (exit status -9)" in struck.said()
    assert struck.process.returncode == 1
    assert struck.archive().status is Status.ABORTED


def test_supervisor_and_control_killed_together(struck: Struck, timed: Callable[[float], None]) -> None:
    timed(struck.until_safe_ms(struck.strike(signal.SIGKILL, "supervisor", "control")))
    assert struck.process.wait(SHORT_S) == -signal.SIGKILL
    assert struck.recovered().pressure.measured_bar[:, 0].max() * 10 > MOVING_V


def test_a_stalled_camera_then_an_unloaded_driver_then_sigterm(
    struck: Struck, player: Player, timed: Callable[[float], None]
) -> None:
    player.process.send_signal(signal.SIGSTOP)
    time.sleep(1.0)
    player.process.send_signal(signal.SIGCONT)
    refused = subprocess.run(["modprobe", "-r", "comedi_test"], capture_output=True, text=True, check=False)
    assert refused.returncode != 0
    assert "in use" in refused.stderr
    time.sleep(1.0)
    assert not struck.over(), struck.said()
    timed(struck.until_safe_ms(struck.strike(signal.SIGTERM, "supervisor")))
    assert "SIGTERM" in struck.said()
    assert struck.process.returncode == 130
    assert struck.archive().status is Status.INTERRUPTED
