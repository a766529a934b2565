"""Detects the exit of another process as early as the kernel shows it."""

from __future__ import annotations

import os

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
