"""Starting the processes of a run: a module, a job, the shared memory."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from dataclasses import dataclass

from rig.executor.base import Plan
from rig.executor.memory import Layout, RunMemory


@dataclass(frozen=True)
class Job:
    """What a process is told on its standard input."""

    plan: Plan
    fd: int
    conductor_pid: int


def spawn(module: str, job: Job) -> subprocess.Popen[bytes]:
    """Start `python -m module` with a job.

    The child gets a session of its own, so that Ctrl-C at the terminal reaches only the conductor: who stops what,
    and in which order, is the conductor's decision. A child that crashes in compiled code says where, on stderr.
    """
    process = subprocess.Popen(
        [sys.executable, "-X", "faulthandler", "-m", module],
        stdin=subprocess.PIPE,
        pass_fds=[job.fd],
        start_new_session=True,
    )
    assert process.stdin is not None
    try:
        pickle.dump(job, process.stdin)
        process.stdin.close()
    except BrokenPipeError:
        pass  # it died at once; the conductor sees that by its exit
    return process


def receive() -> tuple[Job, RunMemory]:
    """In the child: the job and the shared memory."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    job: Job = pickle.load(sys.stdin.buffer)  # written by our own parent, over a pipe
    return job, RunMemory(job.fd, Layout.of(job.plan.config, len(job.plan.adapted)))


def orphaned(job: Job) -> bool:
    """True once the conductor is gone."""
    return os.getppid() != job.conductor_pid
