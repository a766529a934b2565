"""Starts the child processes of a run, monitors their exit, and orders their access to the devices."""

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

from rig.execution.plan import RunPlan
from rig.hardware.vent_verification import VentOutcome
from rig.realtime.shared_state import SharedState, Stop

POLL_S = 0.002
_FLAGS, _PF_EXITING = 6, 0x4
"""The kernel's flags of a process in /proc/PID/stat, counted after the name, and the flag of an exiting process."""


class ProcessMonitor:
    """Monitors one process through an open file of /proc, which stays correct if the process id is reused.

    A pidfd reports the exit only once the memory is released, which takes tens of milliseconds if it is locked or
    large. PF_EXITING is set earlier; it is what is read.
    """

    def __init__(self, pid: int) -> None:
        """Monitor a process; one that does not exist counts as exited."""
        try:
            self._stat = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)
        except (FileNotFoundError, ProcessLookupError):
            self._stat = -1

    @property
    def exited(self) -> bool:
        """True as soon as the process begins to exit."""
        fields = self._fields()
        return not fields or bool(int(fields[_FLAGS]) & _PF_EXITING)

    @property
    def stopped(self) -> bool:
        """True while the process is stopped by a signal or a debugger."""
        return self._fields()[:1] in ([b"T"], [b"t"])

    def _fields(self) -> list[bytes]:
        """Fields of /proc/PID/stat after the name; empty for a process that has gone."""
        try:
            return os.pread(self._stat, 1024, 0).rpartition(b")")[2].split()
        except OSError:
            return []

    def close(self) -> None:
        """End the monitoring."""
        if self._stat >= 0:
            os.close(self._stat)
            self._stat = -1


@dataclass(frozen=True)
class ChildJob:
    """The job of a child process, passed on its standard input."""

    plan: RunPlan
    fd: int
    supervisor_pid: int


def spawn(module: str, job: ChildJob) -> subprocess.Popen[bytes]:
    """Start `python -m module` with a job.

    The child gets its own session, so that Ctrl-C at the terminal reaches only the supervisor, which decides the order
    in which processes stop. A crash in compiled code prints its location on stderr (faulthandler).
    """
    # Not a pipe: a full pipe would block until the child, which may load slowly or stall, has read it.
    with os.fdopen(os.memfd_create("softrig-job"), "w+b") as file:
        pickle.dump(job, file)
        file.seek(0)
        return subprocess.Popen(
            [sys.executable, "-P", "-X", "faulthandler", "-m", module],
            stdin=file,
            pass_fds=[job.fd],
            start_new_session=True,
        )


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
