"""Real-time privileges, punctual waiting, and how the machine behaved meanwhile."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import time
from pathlib import Path

SPIN_NS = 400_000
_MCL_CURRENT_AND_FUTURE = 3


def enable_realtime_scheduling(priority: int) -> list[str]:
    """Ask for SCHED_FIFO and locked memory, and freeze the garbage collector; return what was refused, as sentences."""
    refused = []
    # The priority comes last: locking memory takes a tenth of a second, in which no other run may lose the processor.
    gc.collect()
    gc.freeze()
    gc.disable()
    if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
        refused.append(
            "memory is not locked (mlockall): allow it with '@yourgroup - memlock unlimited' "
            "in /etc/security/limits.conf and log in again"
        )
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError):
        refused.append(
            "no real-time priority (SCHED_FIFO): deadlines may be missed; "
            "allow it with a line '@yourgroup - rtprio 80' in /etc/security/limits.conf and log in again"
        )
    return refused


def raise_priority() -> None:
    """Go before every ordinary program from now on, if that is allowed, and after all that are punctual."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))


def disable_realtime_scheduling() -> None:
    """Give the priority back before the end: what locked memory takes to be given back is nobody's deadline."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def wait_until(deadline_ns: int) -> int:
    """Sleep, then spin for the last 0.4 ms; return the time, which is never before the deadline."""
    now = time.monotonic_ns()
    if (rest := deadline_ns - now - SPIN_NS) > 0:
        time.sleep(rest * 1e-9)
    while (now := time.monotonic_ns()) < deadline_ns:
        pass
    return now


class HeartbeatMonitor:
    """For how long a process has given no sign of life, counting only the time in which somebody watched.

    A look that comes late by itself proves nothing of the other one: the machine may have stood still as a whole. It
    counts as one period, and the other goes on being watched from there. Late looks one after the other are a machine
    that is merely busy, and count in full.
    """

    def __init__(self, period_ns: int, overslept_ns: int) -> None:
        """Looks are due every `period_ns`; those farther apart than `overslept_ns` count as late."""
        self._period_ns, self._overslept_ns = period_ns, overslept_ns
        self._looked_ns = self._heartbeat_ns = 0
        self._silent_ns = 0
        self._late = False

    def look(self, now_ns: int, heartbeat_ns: int) -> int:
        """Return the silence [ns] at a look; `heartbeat_ns` is when the last sign of life was given."""
        since, self._looked_ns = now_ns - (self._looked_ns or now_ns), now_ns
        late = since >= self._overslept_ns
        watched = self._period_ns if late and not self._late else since
        self._late = late
        if heartbeat_ns != self._heartbeat_ns:
            self._heartbeat_ns = heartbeat_ns
            self._silent_ns = min(now_ns - heartbeat_ns, watched)
        else:
            self._silent_ns += watched
        return self._silent_ns


def stolen_ms() -> int:
    """CPU time that the hypervisor took from this machine since boot, all cores, in ms; 0 where it is not told."""
    try:
        fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()
        return int(fields[8]) * 1000 // os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0
