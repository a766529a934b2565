"""Priorities of the processes of a run."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rig.realtime.scheduling import set_niceness


def test_a_niceness_is_given_to_a_running_process_and_one_that_is_refused_leaves_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(which: int, who: int, priority: int) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        assert set_niceness(child.pid, 17) == 17
        assert os.getpriority(os.PRIO_PROCESS, child.pid) == 17
        monkeypatch.setattr(os, "setpriority", refused)
        assert set_niceness(child.pid, -10) == 17
        child.communicate(b"\n")


@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="this kernel has no autogroups")
def test_the_session_of_a_process_that_leads_one_gets_the_same_niceness() -> None:
    command = [sys.executable, "-c", "input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) as child:
        # An ordinary user can only raise it, and `nice make test` has some already.
        niceness = min(19, os.nice(0) + 3)
        set_niceness(child.pid, niceness)
        assert Path(f"/proc/{child.pid}/autogroup").read_text(encoding="ascii").split()[-1] == str(niceness)
        child.communicate(b"\n")


def test_a_niceness_of_a_process_that_has_ended_is_refused() -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    with pytest.raises(ProcessLookupError):
        set_niceness(child.pid, 5)
