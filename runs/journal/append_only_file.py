"""A file that only grows: each data is in it whole or not at all, and what is older than a second is on the disk."""

from __future__ import annotations

import errno
import fcntl
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

SYNC_S = 1.0
RESERVE_BYTES = 32 << 20
"""Free space that is left on the disk beyond what the archive will need."""
ARCHIVE_TO_JOURNAL = 1.2
"""An archive is about as large as its journal: its rows are compressed, its pictures are not."""

WRITE_WAIT_S = 0.05
"""A disk that stands still takes longer than this for one data; its caller is then not held up any more."""
BUFFER_S = 10.0
BUFFER_BYTES = 64 << 20
"""How long, and how much of it, what the disk does not take is kept in memory."""

NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""What the kernel says when a disk, a quota or a limit is full."""


class JournalError(Exception):
    """The journal cannot be written or read; the message says why."""


class JournalFullError(JournalError):
    """The disk is full, or nearly. What earlier calls wrote is intact, and the journal can still be closed."""


class AppendOnlyFile(Protocol):
    """Where a journal's pieces go."""

    @property
    def stalled_s(self) -> float:
        """For how long the disk has not done what it was asked for; 0 where nothing is outstanding."""

    def append(self, data: bytes) -> None:
        """Add a data to the file."""

    def wait_until_synced(self, timeout_s: float) -> bool:
        """Wait until the disk has done what it was asked for; False where it has not by then."""

    def close(self, last: bytes) -> None:
        """Add the last data, see it to the disk, and close the file, whatever goes wrong."""


class DiskFile:
    """Appends in the caller's own thread. The file is locked (flock) while it is open."""

    stalled_s = 0.0

    def __init__(self, path: Path, first: bytes) -> None:
        """Create the file, which must not exist, with its first data.

        Raises:
            JournalError: it cannot be created; nothing is left of it.
        """
        self.path = path
        self.full = ""
        """Why no more is taken, empty while there is room."""
        self._size = 0
        try:
            self._check_free_space(os.statvfs(path.parent))
            if self.full:
                raise JournalFullError(self.full)
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except OSError as fault:
            raise JournalError(f"cannot create {path}: {fault.strerror}") from fault
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX)
            self._synced_at = time.monotonic()
            self.write(first)
        except BaseException:
            os.close(self._fd)
            path.unlink(missing_ok=True)
            raise

    def append(self, data: bytes) -> None:
        """Write it; once a second, sync."""
        self.refuse_if_full()
        self.write(data)
        if time.monotonic() - self._synced_at >= SYNC_S:
            self.sync()
            self.refuse_if_full()

    def wait_until_synced(self, timeout_s: float) -> bool:
        """Nothing is ever outstanding."""
        return True

    def close(self, last: bytes) -> None:
        """Write it even where the room is nearly used up: that is what it was left for."""
        try:
            self.write(last)
            self.sync()
        finally:
            os.close(self._fd)

    def refuse_if_full(self) -> None:
        """Raise where there is no room."""
        if self.full:
            raise JournalFullError(self.full)

    def write(self, data: bytes) -> None:
        """Write all of it or, where there is no room, none."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError as fault:
            # A disk that has turned read-only takes not even that; what is torn is told from what is whole on reading.
            with suppress(OSError):
                os.ftruncate(self._fd, self._size)
            if fault.errno in NO_ROOM:
                self.full = f"the disk with {self.path} is full ({fault.strerror}); what was recorded is intact"
                raise JournalFullError(self.full) from fault
            raise JournalError(f"cannot write {self.path}: {fault.strerror}") from fault
        self._size += len(data)

    def sync(self) -> None:
        """See what was written to the disk, and look whether the room still suffices."""
        try:
            os.fdatasync(self._fd)
            self._check_free_space(os.fstatvfs(self._fd))
        except OSError as fault:
            raise JournalError(f"cannot write {self.path} to its disk: {fault.strerror}") from fault
        self._synced_at = time.monotonic()

    def _check_free_space(self, disk: os.statvfs_result) -> None:
        """Stop while there is still room for the archive."""
        free, needed = disk.f_bavail * disk.f_frsize, RESERVE_BYTES + ARCHIVE_TO_JOURNAL * self._size
        if free < needed:
            self.full = (
                f"the disk with {self.path} is nearly full: {free / 1e6:.0f} MB free, {needed / 1e6:.0f} MB needed "
                "to finish this run; what was recorded is intact"
            )


class BufferedFile:
    """Appends to a `File` without ever waiting for its disk: what that does not take is kept in memory meanwhile.

    Two threads, because a disk may take what is written, into the kernel's memory, long before a sync returns. A call
    that finds nothing outstanding waits the idle moment until its data is written, so that what it returned from
    survives kill -9 wherever the disk does not stand still.
    """

    def __init__(self, file: DiskFile, patience_s: float | None = None) -> None:
        """`patience_s` is for how long the disk may take nothing; `BUFFER_S` where it is None."""
        self._file = file
        self._patience_s = patience_s
        self._changed = threading.Condition()
        self._outstanding: deque[tuple[float, bytes]] = deque()
        """When each data came; the first is the one that is being written."""
        self._bytes = 0
        self._syncing_since: float | None = None
        self._fault: JournalError | None = None
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._write, self._sync)]
        for thread in self._threads:
            thread.start()

    @property
    def stalled_s(self) -> float:
        """For how long the disk has not done the oldest of what it was asked for; 0 where nothing is outstanding."""
        with self._changed:
            since = [] if self._syncing_since is None else [self._syncing_since]
            if self._outstanding:
                since.append(self._outstanding[0][0])
        return time.monotonic() - min(since) if since else 0.0

    def append(self, data: bytes) -> None:
        """Hand it over; what has gone wrong since the last call is raised by this one."""
        with self._changed:
            self._raise_fault()
            idle = not self._outstanding
            self._outstanding.append((time.monotonic(), data))
            self._bytes += len(data)
            self._changed.notify_all()
            if idle:
                self._changed.wait_for(lambda: not self._outstanding, WRITE_WAIT_S)
                self._raise_fault()

    def wait_until_synced(self, timeout_s: float) -> bool:
        """Wait for the disk."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not self._outstanding and self._syncing_since is None, timeout=timeout_s
            )

    def close(self, last: bytes) -> None:
        """Wait for the disk as long as it takes, then close; raise what no call has raised yet."""
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()
        self._file.close(last)
        if self._fault is not None:
            raise self._fault

    def _raise_fault(self) -> None:
        """Raise where the file or its disk takes no more."""
        if self._fault is not None:
            fault, self._fault = self._fault, None
            raise fault
        self._file.refuse_if_full()
        if not self._outstanding:
            return
        stalled_s = time.monotonic() - self._outstanding[0][0]
        if stalled_s > (BUFFER_S if self._patience_s is None else self._patience_s) or self._bytes > BUFFER_BYTES:
            raise JournalError(
                f"the disk with {self._file.path} has taken nothing for {stalled_s:.1f} s; "
                f"{self._bytes / 1e6:.1f} MB wait in memory until it does"
            )

    def _write(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._outstanding) or self._closing.is_set())
                if not self._outstanding:
                    return
                _, data = self._outstanding[0]
            written = self._attempt(self._file.write, data)
            with self._changed:
                for _ in range(1 if written else len(self._outstanding)):
                    self._bytes -= len(self._outstanding.popleft()[1])
                self._changed.notify_all()

    def _sync(self) -> None:
        while not self._closing.wait(SYNC_S):
            with self._changed:
                self._syncing_since = time.monotonic()
            self._attempt(self._file.sync)
            with self._changed:
                self._syncing_since = None
                self._changed.notify_all()

    def _attempt(self, step: Callable[..., None], *arguments: bytes) -> bool:
        """Do it; keep what goes wrong for the next call."""
        try:
            step(*arguments)
        except JournalError as fault:
            self._fault = fault
            return False
        return True
