"""How many processors a process may use."""

from __future__ import annotations

import os


def usable_processors() -> int:
    """Number of processors of this process: a job of a cluster may have fewer than the machine."""
    # Windows and macOS have no affinity.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
