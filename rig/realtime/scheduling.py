"""Real-time scheduling, precise waiting, heartbeat monitors; stolen and suspended time of the computer."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import platform
import resource
import struct
import time
from enum import IntFlag
from pathlib import Path

SPIN_NS = 400_000
_MCL_CURRENT_AND_FUTURE = 3
_CAP_IPC_LOCK = 14
SLICE_NS = 100_000
"""The shortest time slice that the kernel grants."""
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
_ATTRIBUTES_BYTES = 48
WATCHDOG_PRIORITY, CONTROL_PRIORITY = 60, 50
PLANNING_NICENESS = -10
"""Of the tip controller: above ordinary processes, below every process with SCHED_FIFO."""


class Scheduling(IntFlag):
    """What the kernel has granted to a process: SCHED_FIFO, and locked memory (mlockall)."""

    NONE = 0
    FIFO = 1
    LOCKED = 2


REAL_TIME = Scheduling.FIFO | Scheduling.LOCKED


def enable_realtime_scheduling(priority: int) -> Scheduling:
    """Request SCHED_FIFO and locked memory, and freeze the garbage collector; return what was granted."""
    granted = Scheduling.NONE
    # The priority comes last: locking memory takes 0.1 s, during which another run must not lose the processor.
    gc.collect()
    gc.freeze()
    gc.disable()
    _raise_soft_limits()
    if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) == 0:
        granted |= Scheduling.LOCKED
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError):
        _request_short_slice()
        return granted
    return granted | Scheduling.FIFO


def _request_short_slice() -> None:
    """Request short time slices of the ordinary scheduler (EEVDF, Linux 6.12 or later).

    A process with short time slices has early virtual deadlines and runs soon after it wakes, at an unchanged share of
    the processor. This needs no privilege; older kernels ignore it. The C library has no function for sched_setattr.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None:
        return
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = struct.pack("=IIQiIQQQ", _ATTRIBUTES_BYTES, os.SCHED_OTHER, 0, nice, 0, SLICE_NS, 0, 0)
    ctypes.CDLL(None).syscall(number, 0, ctypes.create_string_buffer(attributes), 0)


def obtainable() -> Scheduling:
    """The scheduling that a child process will be granted.

    The priority is set and reset in this thread. Locking memory would take 0.1 s and is not tried: it is granted to a
    process with CAP_IPC_LOCK or without a limit.
    """
    granted = Scheduling.NONE
    _raise_soft_limits()
    memlock = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if memlock == resource.RLIM_INFINITY or _capable(_CAP_IPC_LOCK):
        granted |= Scheduling.LOCKED
    try:
        previous = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(WATCHDOG_PRIORITY))
        os.sched_setscheduler(0, *previous)
    except (OSError, AttributeError):
        return granted
    return granted | Scheduling.FIFO


def remedies(granted: Scheduling) -> str:
    """What was not granted, and the configuration line that allows it; empty if all was granted."""
    refused = []
    if Scheduling.LOCKED not in granted:
        refused.append(
            "memory is not locked (mlockall): allow it with '@yourgroup - memlock unlimited' "
            "in /etc/security/limits.conf and log in again"
        )
    if Scheduling.FIFO not in granted:
        refused.append(
            "no real-time priority (SCHED_FIFO): deadlines may be missed; "
            "allow it with a line '@yourgroup - rtprio 80' in /etc/security/limits.conf and log in again"
        )
    return "; ".join(refused)


def _raise_soft_limits() -> None:
    """Raise the soft limits to the hard limits, which needs no privilege."""
    for limit in (resource.RLIMIT_MEMLOCK, resource.RLIMIT_RTPRIO):
        soft, hard = resource.getrlimit(limit)
        if soft != hard:
            with contextlib.suppress(OSError, ValueError):
                resource.setrlimit(limit, (hard, hard))


def _capable(capability: int) -> bool:
    """True where the effective capabilities of this process contain one."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("CapEff:"):
                return bool(int(line.split()[1], 16) >> capability & 1)
    return False


def raise_priority() -> None:
    """Set a low SCHED_FIFO priority, if allowed: above ordinary processes, below control and watchdog."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))


def set_niceness(pid: int, niceness: int) -> int:
    """Request a niceness for a process of this user; return the one that it has.

    Where Linux shares the processor among sessions (autogroup), the niceness of a process counts within its session
    only. The session of a process that leads one gets the same niceness.
    """
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, niceness)
        if os.getsid(pid) == pid:
            Path(f"/proc/{pid}/autogroup").write_text(str(niceness), encoding="ascii")
    return os.getpriority(os.PRIO_PROCESS, pid)


def disable_realtime_scheduling() -> None:
    """Return to ordinary scheduling before the exit, because releasing locked memory is slow and not urgent."""
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
    """Measures how long a process has sent no heartbeat, without counting stalls of the whole machine.

    If the monitor itself is sampled late, the machine may have stalled: a single late interval counts as one period.
    Consecutive late intervals mean a busy machine and count in full.
    """

    def __init__(self, period_ns: int, late_ns: int) -> None:
        """It is sampled every `period_ns`; a sample at least `late_ns` after the previous one counts as late."""
        self._period_ns, self._late_ns = period_ns, late_ns
        self._checked_ns = self._heartbeat_ns = 0
        self._silent_ns = 0
        self._late = False

    def silent_ns(self, now_ns: int, heartbeat_ns: int) -> int:
        """Sample the monitor: return the silence [ns]; `heartbeat_ns` is the time of the last heartbeat."""
        since, self._checked_ns = now_ns - (self._checked_ns or now_ns), now_ns
        late = since >= self._late_ns
        watched = self._period_ns if late and not self._late else since
        self._late = late
        if heartbeat_ns != self._heartbeat_ns:
            self._heartbeat_ns = heartbeat_ns
            self._silent_ns = min(now_ns - heartbeat_ns, watched)
        else:
            self._silent_ns += watched
        return self._silent_ns


def suspended_ns() -> int:
    """Time that this computer has been suspended since boot [ns], which CLOCK_BOOTTIME alone counts."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


def steal_time_ms() -> int:
    """CPU time that the hypervisor took from this machine since boot, all cores [ms]; 0 if it is not reported."""
    try:
        fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()
        return int(fields[8]) * 1000 // os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0
