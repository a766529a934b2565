"""The control periods of a calibration in real time, and the watchdog beside them."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rig.config.loader
from rig.calibrate import bench_session
from rig.calibrate.bench_session import RealTimeClock, real
from rig.execution.plan import StartError
from rig.hardware.cards.base import CardError
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.scheduling import Scheduling
from rig.realtime.shared_state import SharedState
from rig.realtime.timing_limits import TimingLimits, TimingProfile
from rig.simulator.registers import Registers
from tests.support.mock_registers import mock_registers

PERIOD_NS = 2_000_000
TIMING = TimingLimits(TimingProfile.STRICT, control_hung_ns=30_000_000)


@pytest.fixture
def memory() -> Iterator[SharedState]:
    memory = SharedState.create(rig.config.loader.load("mock"))
    yield memory
    os.close(memory.fd)


@pytest.fixture
def watchdog() -> Iterator[subprocess.Popen[bytes]]:
    """A process that lives."""
    with subprocess.Popen(["sleep", "60"]) as process:
        yield process
        process.kill()


def test_every_period_sends_a_heartbeat_and_a_dead_watchdog_ends_the_session(
    memory: SharedState, watchdog: subprocess.Popen[bytes]
) -> None:
    clock = RealTimeClock(memory, PERIOD_NS, ProcessMonitor(watchdog.pid), TIMING)
    before, now = clock.next(), clock.next()
    assert now > before
    assert memory.heartbeat_ns("control") == memory.heartbeat_ns("supervisor") == now
    watchdog.kill()
    watchdog.wait()
    with pytest.raises(StartError, match="the watchdog process died"):
        clock.next()


def test_a_watchdog_without_heartbeat_ends_the_session(memory: SharedState, watchdog: subprocess.Popen[bytes]) -> None:
    clock = RealTimeClock(
        memory, PERIOD_NS, ProcessMonitor(watchdog.pid), replace(TIMING, watchdog_silent_ns=100 * PERIOD_NS)
    )
    for _ in range(20):
        memory.heartbeat("watchdog", time.monotonic_ns())
        clock.next()
    with pytest.raises(StartError, match="the watchdog is silent"):
        deque((clock.next() for _ in range(10_000)), maxlen=0)


def test_a_takeover_by_the_watchdog_is_reported_with_its_reason(
    memory: SharedState, watchdog: subprocess.Popen[bytes]
) -> None:
    clock = RealTimeClock(memory, PERIOD_NS, ProcessMonitor(watchdog.pid), TIMING)
    memory.flags["watchdog"]["message"] = b"the control process hung"
    memory.watchdog_trip_ns = 1
    with pytest.raises(StartError, match="took the bench over: the control process hung"):
        clock.next()


@pytest.fixture
def empty() -> Iterator[Registers]:
    """A mock card that samples chambers without pressure, whatever its valves do."""
    ended = threading.Event()
    with mock_registers(f"clocked-{os.getpid()}") as registers:

        def sample() -> None:
            while not ended.wait(0.002):
                registers.push_scans(np.array([time.monotonic_ns()]), np.zeros((1, 8)))

        sampling = threading.Thread(target=sample)
        sampling.start()
        yield registers
        ended.set()
        sampling.join()


def test_valves_vented_by_another_program_stay_vented_where_the_session_would_hold_them(
    empty: Registers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_session, "enable_realtime_scheduling", lambda priority: Scheduling.NONE)
    text = rig.config.loader.text("mock").replace("device: mock0", f"device: clocked-{os.getpid()}", 1)
    text = text.replace("type: flow\n", "type: flow\n    safe_state: hold\n").replace("stale_s: 0.1", "stale_s: 5")
    file = tmp_path / "rig.yaml"
    file.write_text(text.replace("  no_tip_s: 1.0\n", "  no_tip_s: 1.0\n  hung_s: 5\n"))
    config = rig.config.loader.load(file)
    told = np.array([6.0, 7.0])
    stood = []

    def drive() -> None:
        with real(config, file) as (valves, clock):
            stood.append(empty.outputs["value"].tolist())
            valves.write(told)
            clock.next()
            valves.write(told)
            stood.append(empty.outputs["value"].tolist())
            empty.outputs["value"] = 0.0
            valves.write(told)

    with pytest.raises(CardError, match="another program has written to the card"):
        drive()
    assert stood == [pytest.approx([5.0, 5.0], abs=1e-3), pytest.approx(told.tolist(), abs=1e-3)]
    assert empty.outputs["value"].tolist() == [0.0, 0.0]
