"""Processes of the test's own in the place of those of a run."""

from __future__ import annotations

import subprocess
import sys

from rig.realtime.process_group import ProcessGroup

SLEEPS = "import time; time.sleep(60)"
"""A program that does nothing for a minute."""


def child(group: ProcessGroup, name: str, program: str) -> subprocess.Popen[bytes]:
    """Add a process that runs a Python program to a group."""
    process = subprocess.Popen([sys.executable, "-c", program])
    group.add(name, process)
    return process
