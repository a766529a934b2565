"""Starting the processes of a run: a module, a job, the shared memory, and each one's turn to touch the devices."""

from __future__ import annotations

import os
import pickle
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from rig.execution.plan import Plan
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.shared_state import SharedState, StateLayout, Stop

TURN_S = 0.002


@dataclass(frozen=True)
class ChildJob:
    """What a process is told on its standard input."""

    plan: Plan
    fd: int
    supervisor_pid: int


def spawn(module: str, job: ChildJob) -> subprocess.Popen[bytes]:
    """Start `python -m module` with a job.

    The child gets a session of its own, so that Ctrl-C at the terminal reaches only the supervisor: who stops what,
    and in which order, is the supervisor's decision. A child that crashes in compiled code says where, on stderr.
    """
    # Not by a pipe: one that is full waits for a child that may be long in loading, or stand still.
    with os.fdopen(os.memfd_create("softrig-job"), "w+b") as told:
        pickle.dump(job, told)
        told.seek(0)
        return subprocess.Popen(
            [sys.executable, "-P", "-X", "faulthandler", "-m", module],
            stdin=told,
            pass_fds=[job.fd],
            start_new_session=True,
        )


def ended_within(process: subprocess.Popen[bytes], timeout_s: float) -> bool:
    """Wait for a process; True once it has ended. `Popen.wait` looks only every twentieth of a second."""
    if process.poll() is None:
        exit_fd = os.pidfd_open(process.pid)
        try:
            select.select([exit_fd], [], [], timeout_s)
        finally:
            os.close(exit_fd)
    return process.poll() is not None


def receive() -> tuple[ChildJob, SharedState]:
    """In the child: the job and the shared memory."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    job: ChildJob = pickle.load(sys.stdin.buffer)  # written by our own parent
    return job, SharedState(job.fd, StateLayout.of(job.plan.config, len(job.plan.adapted)))


def leave(status: int) -> NoReturn:
    """In the child: end, and spare the supervisor, who waits, the taking apart of an interpreter that is not needed."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def supervisor_monitor(job: ChildJob) -> ProcessMonitor:
    """In the child: the life of its supervisor."""
    monitor = ProcessMonitor(job.supervisor_pid)
    if os.getppid() != job.supervisor_pid:
        # Gone already; the number may be somebody else's by now.
        monitor.close()
    return monitor


def await_turn(memory: SharedState, supervisor: ProcessMonitor, come: Callable[[], bool]) -> bool:
    """Wait until this process may touch the devices; False when the run is over before it began.

    What a process has to load takes longer than all else in a start: all load at once, and then come in their order.
    """
    while not come():
        if memory.stop_request != Stop.NONE or supervisor.exited:
            return False
        time.sleep(TURN_S)
    return True
