"""Locks of journals: the kernel releases them when their process dies.

Experiments run on Linux. Where the system has no such locks (Windows), no process writes a journal, and none is held.
"""

from __future__ import annotations

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def lock(handle: int, *, wait: bool = False) -> None:
    """Lock an open file for this process. Raises BlockingIOError if another has it and `wait` is false."""
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
