"""The watchdog decides whether the supervisor is left to verify the safe state."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.watchdog_process import _supervisor_exits


@pytest.fixture
def supervisor() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(["sleep", "60"])
    yield process
    process.kill()
    process.wait()


def heartbeats(t_ns: int) -> Any:
    return SimpleNamespace(heartbeat_ns=lambda name: t_ns)


def test_a_supervisor_that_was_killed_a_moment_ago_counts_as_dead(supervisor: subprocess.Popen[bytes]) -> None:
    threading.Timer(0.03, supervisor.kill).start()
    assert _supervisor_exits(heartbeats(time.monotonic_ns()), ProcessMonitor(supervisor.pid))


def test_a_supervisor_whose_heartbeat_goes_on_is_alive(supervisor: subprocess.Popen[bytes]) -> None:
    later_ns = time.monotonic_ns() + 10**12
    assert not _supervisor_exits(heartbeats(later_ns), ProcessMonitor(supervisor.pid))


def test_a_supervisor_that_neither_exits_nor_beats_is_not_waited_for(supervisor: subprocess.Popen[bytes]) -> None:
    assert not _supervisor_exits(heartbeats(0), ProcessMonitor(supervisor.pid))
