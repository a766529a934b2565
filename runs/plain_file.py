"""Opens files in folders that other users may write: no link or FIFO in their place is followed or waited for."""

from __future__ import annotations

import os
import stat
from pathlib import Path


class IrregularFileError(OSError):
    """A link, a FIFO, a folder or a device has the name of a file."""


def open_plain(path: Path, flags: int = os.O_RDONLY) -> int:
    """Open a regular file and return its descriptor; `flags` with O_CREAT makes it.

    Raises:
        IrregularFileError: what has the name is no regular file.
        OSError: it cannot be opened.
    """
    try:
        descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except OSError:
        if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
            raise IrregularFileError(f"{path}: this is not a regular file") from None
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise IrregularFileError(f"{path}: this is not a regular file")
    return descriptor


def read_plain(path: Path) -> bytes:
    """Return the content of a regular file. Raises as `open_plain`."""
    with open(open_plain(path), "rb") as file:
        return file.read()
