"""Whether another process lives, as early as the kernel tells."""

from __future__ import annotations

import os

_FLAGS, _PF_EXITING = 6, 0x4
"""The kernel's flags of a process in /proc/PID/stat, counted after the name, and the one of a process that dies."""


class ProcessMonitor:
    """The life of one process, followed from now on; its number may be another's later, this is not fooled by that.

    A process counts as ended only once its memory is given back, which takes tens of milliseconds where that is locked
    or large. The flag that it dies comes first, and that is what is read.
    """

    def __init__(self, pid: int) -> None:
        """Follow a process; one that does not exist is over."""
        try:
            self._stat = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)
        except (FileNotFoundError, ProcessLookupError):
            self._stat = -1

    @property
    def exited(self) -> bool:
        """True as soon as the process begins to die."""
        fields = self._fields()
        return not fields or bool(int(fields[_FLAGS]) & _PF_EXITING)

    @property
    def stopped(self) -> bool:
        """True while the process lives but was stopped, by a signal or a debugger."""
        return self._fields()[:1] in ([b"T"], [b"t"])

    def _fields(self) -> list[bytes]:
        """What the kernel tells of the process after its name; nothing of one that is gone."""
        try:
            return os.pread(self._stat, 1024, 0).rpartition(b")")[2].split()
        except OSError:
            return []

    def close(self) -> None:
        """Follow it no longer."""
        if self._stat >= 0:
            os.close(self._stat)
            self._stat = -1
