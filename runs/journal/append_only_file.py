"""Append-only file: every append is atomic, and is synced to the disk within about a second."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


SYNC_S = 1.0
RESERVE_BYTES = 32 << 20
"""Free disk space to leave in addition to the space for the archive."""
ARCHIVE_TO_JOURNAL = 1.2
"""An archive is about as large as its journal: its rows are compressed, its pictures are not."""

WRITE_WAIT_S = 0.05
"""Longest time for which `append` waits for the write; on a stalled disk it then returns."""
BUFFER_S = 10.0
BUFFER_BYTES = 64 << 20
"""Limits in time and size of the buffer in memory while the disk is stalled."""

NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Errors of the kernel for a full disk, quota or file size limit."""


class JournalError(Exception):
    """The journal cannot be written or read; the message has the reason."""


class JournalExistsError(JournalError):
    """Another run has taken the name of the journal."""


class JournalFullError(JournalError):
    """The disk is full, or nearly. Earlier records are intact, and the journal can still be closed."""


def lock(handle: int, *, wait: bool = False) -> None:
    """Lock an open file for this process; the kernel releases it when the process dies.

    Experiments run on Linux. Where the system has no such locks (Windows), no process writes a journal, and none is
    held. Raises BlockingIOError if another process has the lock and `wait` is false.
    """
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


class DiskFile:
    """Appends in the thread of the caller. The file is locked (flock) while it is open."""

    stalled_s = 0.0
    """Writes are done when they return."""

    def __init__(self, path: Path, first: bytes) -> None:
        """Create the file, which must not exist, with its first block.

        Raises:
            JournalError: it cannot be created; nothing is left of it.
        """
        self.path = path
        self.full = ""
        """Reason why no more is accepted; empty while there is space."""
        self._size = 0
        try:
            self._check_free_space(os.statvfs(path.parent))
            if self.full:
                raise JournalFullError(self.full)
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError as fault:
            raise JournalExistsError(f"cannot create {path}: {fault.strerror}") from fault
        except OSError as fault:
            raise JournalError(f"cannot create {path}: {fault.strerror}") from fault
        try:
            lock(self._fd, wait=True)
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
        """True: writes are synchronous."""
        return True

    def close(self, last: bytes) -> None:
        """Write the last block also into the reserved space, and close."""
        try:
            self.write(last)
            self.sync()
        finally:
            os.close(self._fd)

    def refuse_if_full(self) -> None:
        """Raise if the disk is full."""
        if self.full:
            raise JournalFullError(self.full)

    def write(self, data: bytes) -> None:
        """Write all of it or, if there is no space, nothing."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._fd, rest) :]
        except OSError as fault:
            # Truncation fails on a disk that turned read-only; the reader detects a torn block by its checksum.
            with suppress(OSError):
                os.ftruncate(self._fd, self._size)
            if fault.errno in NO_ROOM:
                self.full = f"the disk with {self.path} is full ({fault.strerror}); what was recorded is intact"
                raise JournalFullError(self.full) from fault
            raise JournalError(f"cannot write {self.path}: {fault.strerror}") from fault
        self._size += len(data)

    def sync(self) -> None:
        """Sync to the disk and check the free space."""
        try:
            os.fdatasync(self._fd)
            self._check_free_space(os.fstatvfs(self._fd))
        except OSError as fault:
            raise JournalError(f"cannot write {self.path} to its disk: {fault.strerror}") from fault
        self._synced_at = time.monotonic()

    def _check_free_space(self, disk: os.statvfs_result) -> None:
        """Set `full` while there is still space for the archive."""
        free, needed = disk.f_bavail * disk.f_frsize, RESERVE_BYTES + ARCHIVE_TO_JOURNAL * self._size
        if free < needed:
            self.full = (
                f"the disk with {self.path} is nearly full: {free / 1e6:.0f} MB free, {needed / 1e6:.0f} MB needed "
                "to finish this run; what was recorded is intact"
            )


class BufferedFile:
    """Appends to a `DiskFile` through a buffer in memory, so that a stalled disk does not block the caller.

    Writes and syncs have a thread each, because a write into the page cache returns long before a sync. If the buffer
    is empty, `append` waits up to `WRITE_WAIT_S` for its write, so that its data survive kill -9 if the disk works.
    """

    def __init__(self, file: DiskFile, patience_s: float | None = None) -> None:
        """`patience_s` is the longest accepted stall of the disk; None for `BUFFER_S`."""
        self._file = file
        self._patience_s = patience_s
        self._changed = threading.Condition()
        self._outstanding: deque[tuple[float, bytes]] = deque()
        """Time and content of each block; the first is being written."""
        self._bytes = 0
        self._appended = self._synced = 0
        """Number of blocks so far, and of those that a sync has covered."""
        self._syncing_since: float | None = None
        self._fault: JournalError | None = None
        self._closing = threading.Event()
        self._sync_due = threading.Event()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._write, self._sync)]
        for thread in self._threads:
            thread.start()

    @property
    def stalled_s(self) -> float:
        """Age [s] of the oldest unfinished write or sync; 0 if there is none."""
        with self._changed:
            since = [] if self._syncing_since is None else [self._syncing_since]
            if self._outstanding:
                since.append(self._outstanding[0][0])
        return time.monotonic() - min(since) if since else 0.0

    def append(self, data: bytes) -> None:
        """Buffer a block; raises the error of an earlier write or sync."""
        with self._changed:
            self._raise_fault()
            idle = not self._outstanding
            self._outstanding.append((time.monotonic(), data))
            self._appended += 1
            self._bytes += len(data)
            self._changed.notify_all()
            if idle:
                self._changed.wait_for(lambda: not self._outstanding, WRITE_WAIT_S)
                self._raise_fault()

    def wait_until_synced(self, timeout_s: float) -> bool:
        """Wait until a sync has covered all that was appended before, or has failed; False on timeout."""
        until = time.monotonic() + timeout_s
        with self._changed:
            wanted = self._appended
            if not self._changed.wait_for(lambda: not self._outstanding, timeout_s):
                return False
            self._sync_due.set()
            return self._changed.wait_for(lambda: self._synced >= wanted, max(0.0, until - time.monotonic()))

    def close(self, last: bytes) -> None:
        """Wait for the disk without limit, then close; raises a pending error."""
        self._closing.set()
        self._sync_due.set()
        with self._changed:
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()
        self._file.close(last)
        if self._fault is not None:
            raise self._fault

    def _raise_fault(self) -> None:
        """Raise a pending error, or if the disk is full or stalled for too long."""
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
        while True:
            self._sync_due.wait(SYNC_S)
            self._sync_due.clear()
            if self._closing.is_set():
                return
            with self._changed:
                self._syncing_since = time.monotonic()
                covered = self._appended - len(self._outstanding)
            self._attempt(self._file.sync)
            with self._changed:
                self._syncing_since = None
                self._synced = covered
                self._changed.notify_all()

    def _attempt(self, step: Callable[..., None], *arguments: bytes) -> bool:
        """Run a step; store its error for the next call."""
        try:
            step(*arguments)
        except JournalError as fault:
            self._fault = fault
            return False
        return True
