"""The digest of an archive, checked before anything of the file is parsed.

The last bytes of an archive are its trailer: a line of fixed length with the SHA-256 of all bytes before it. HDF5 takes
the end of a file from its head and ignores what follows, so every HDF5 reader opens the file; a user block at the head
would serve as well, but some readers look for HDF5 at byte 0 only. A copied or renamed archive keeps its trailer. A
file that was cut off has none, and a program that changes the file by HDF5 removes it.
"""

from __future__ import annotations

import hashlib
import os
import stat
from contextlib import suppress
from pathlib import Path

from runs import own_cache

_HEAD = b"\nsoftrig archive, SHA-256 of all bytes before this line: "
_DIGITS = 2 * hashlib.sha256().digest_size
TRAILER_BYTES = len(_HEAD) + _DIGITS + 1
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_PIECE = 1 << 20
REMEMBERED_BYTES = 16 << 20
"""Larger archives are read for their digest once, and then known by size and time; a smaller one takes some 50 ms."""
_KEEP_S = 30 * 86400.0

Stamp = tuple[int, int, int, int, int]
"""Device, inode, size, and times of content and of inode of a file."""
_digests: dict[Stamp, str] = {}
"""Of the files that this process has checked, or was told to accept."""


class ArchiveError(Exception):
    """The archive could not be written or is invalid; the message has the reason. The journal is unchanged."""


class DamagedArchiveError(ArchiveError):
    """The file is not the one that softrig wrote."""


def seal(path: Path) -> str:
    """Append the trailer to a file and return its digest.

    Raises:
        OSError: the file cannot be read or written.
    """
    with path.open("r+b") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
        file.seek(0, os.SEEK_END)
        file.write(_HEAD + found.encode() + b"\n")
    return found


def checked(path: Path) -> str:
    """Return the digest of an archive whose content has it.

    Raises:
        DamagedArchiveError: the content has another digest, or the file has none.
        ArchiveError: the file is no archive.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise ArchiveError(f"{path}: not an archive of softrig: it is no file")
        stamp = (about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns)
        if stamp in _digests:
            return _digests[stamp]
        stated = _stated(path, file.fileno(), about.st_size)
        if not (_is_remembered(stamp) or _of_content(file.fileno(), about.st_size) == stated):
            raise DamagedArchiveError(
                f"{path}: damaged: its content does not have the SHA-256 that it ends with; {_REMEDY}"
            )
    _remember(stamp)
    _digests[stamp] = stated
    return stated


def accept(path: Path) -> None:
    """Let this process read an archive whatever its digest is, as long as the file stays as it is.

    Raises:
        OSError: there is no such file.
    """
    about = path.stat()
    stamp = (about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns)
    with path.open("rb") as file:
        _digests[stamp] = hashlib.file_digest(file, "sha256").hexdigest()


_REMEDY = (
    "copy it again, or rebuild it from its journal (rig recover); `--force` of rig show, report and export reads it as "
    "it is"
)


def _stated(path: Path, descriptor: int, size: int) -> str:
    """Return the digest of the trailer. Raises `ArchiveError` if there is none."""
    trailer = os.pread(descriptor, TRAILER_BYTES, max(0, size - TRAILER_BYTES))
    stated = trailer[len(_HEAD) : -1].decode("latin-1")
    if trailer != _HEAD + stated.encode("latin-1") + b"\n" or set(stated) - set("0123456789abcdef"):
        if os.pread(descriptor, len(_SIGNATURE), 0) != _SIGNATURE:
            raise ArchiveError(f"{path}: not an archive of softrig: it is {'no HDF5 file' if size else 'empty'}")
        raise DamagedArchiveError(
            f"{path}: it does not end with its digest, so it was cut off, changed by another program or not made by "
            f"softrig; {_REMEDY}"
        )
    return stated


def _of_content(descriptor: int, size: int) -> str:
    digest = hashlib.sha256()
    end = size - TRAILER_BYTES
    for low in range(0, end, _PIECE):
        digest.update(os.pread(descriptor, min(_PIECE, end - low), low))
    return digest.hexdigest()


def _is_remembered(stamp: Stamp) -> bool:
    return stamp[2] > REMEMBERED_BYTES and (mark := _mark(stamp)) is not None and mark.exists()


def _remember(stamp: Stamp) -> None:
    """Leave an empty file whose name is that of the archive's size and times."""
    if stamp[2] > REMEMBERED_BYTES and (mark := _mark(stamp)) is not None:
        with suppress(OSError):
            mark.touch(mode=0o600)
            own_cache.forget_old(mark.parent, _KEEP_S)


def _mark(stamp: Stamp) -> Path | None:
    folder = own_cache.folder("digests")
    return None if folder is None else folder / hashlib.sha256(repr(stamp).encode()).hexdigest()[:32]
