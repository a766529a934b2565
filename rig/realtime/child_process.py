"""Starts the child processes of a run: module, job, shared memory, and the order in which they open the devices."""

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
from importlib.util import find_spec
from typing import NoReturn

from rig.execution.plan import RunPlan
from rig.execution.stop_signals import VENT_SIGNAL
from rig.hardware.running import vent_signal_held_back
from rig.hardware.vent_verification import VentOutcome
from rig.realtime.process_monitor import ProcessMonitor
from rig.realtime.shared_state import SharedState, Stop

POLL_S = 0.002
_LIBRARIES = ("cv2", "numba", "scipy")


@dataclass(frozen=True)
class ChildJob:
    """The job of a child process, passed on its standard input."""

    plan: RunPlan
    fd: int
    supervisor_pid: int


def require_libraries() -> None:
    """Raise ModuleNotFoundError if this installation lacks a library that the processes of a run need."""
    for name in _LIBRARIES:
        if find_spec(name) is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def spawn(module: str, job: ChildJob) -> subprocess.Popen[bytes]:
    """Start `python -m module` with a job.

    The child gets its own session, so that Ctrl-C at the terminal reaches only the supervisor, which decides the order
    in which processes stop. A crash in compiled code prints its location on stderr (faulthandler).
    """
    # Not a pipe: a full pipe would block until the child, which may load slowly or stall, has read it.
    with os.fdopen(os.memfd_create("softrig-job"), "w+b") as file:
        pickle.dump(job, file)
        file.seek(0)
        with vent_signal_held_back():
            return subprocess.Popen(
                [sys.executable, "-P", "-X", "faulthandler", "-m", module],
                stdin=file,
                pass_fds=[job.fd],
                start_new_session=True,
            )


def vent_at_signal(memory: SharedState) -> None:
    """In a child that writes to the cards: vent at the signal of `rig vent`, also at one that came while it loaded."""
    signal.signal(VENT_SIGNAL, lambda *_: memory.request_stop(Stop.VENT_COMMAND))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {VENT_SIGNAL})


def ended_within(process: subprocess.Popen[bytes], timeout_s: float) -> bool:
    """Wait for a process; True once it has ended. `Popen.wait` polls only every 50 ms."""
    if process.poll() is None:
        exit_fd = os.pidfd_open(process.pid)
        try:
            select.select([exit_fd], [], [], timeout_s)
        finally:
            os.close(exit_fd)
    return process.poll() is not None


def receive_job(*, tip_controller: bool = False) -> tuple[ChildJob, SharedState]:
    """In the child: the job and the shared memory, of which the tip controller can write its own pages only."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    job: ChildJob = pickle.load(sys.stdin.buffer)  # written by the parent process
    return job, SharedState(job.fd, job.plan.config, len(job.plan.adapted), tip_controller=tip_controller)


def exit_process(status: int) -> NoReturn:
    """In the child: exit without interpreter shutdown, for which the supervisor would wait."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def supervisor_monitor(job: ChildJob) -> ProcessMonitor:
    """In the child: the monitor of its supervisor."""
    monitor = ProcessMonitor(job.supervisor_pid)
    if os.getppid() != job.supervisor_pid:
        # The supervisor has exited; its process id may be reused.
        monitor.close()
    return monitor


def await_device_access(memory: SharedState, supervisor: ProcessMonitor, ready: Callable[[], bool]) -> bool:
    """Wait until this process may open the devices; False if the run ends before that.

    Loading takes longest in a start, so all processes load in parallel and then open the devices in a fixed order.
    """
    while not ready():
        if memory.stop_request != Stop.NONE or supervisor.exited:
            return False
        time.sleep(POLL_S)
    return True


def report_end(failure: str, verify: Callable[[], VentOutcome]) -> None:
    """Print why the safe state could not be written, else what `verify` does not confirm; nothing if all is well.

    For a process whose supervisor has exited.
    """
    if not failure and not (outcome := verify()).confirmed:
        failure = outcome.sentence
    if failure:
        report(failure)


def report(message: str) -> None:
    """Print on the terminal, for a process that is the last of its run: no channel has a reader any more."""
    print(message, file=sys.stderr, flush=True)
