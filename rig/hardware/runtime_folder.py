"""A folder that only its user can write: locks, control sockets and the files of simulated cards.

Its place depends on the user alone, not on environment variables, so that every process of a user finds it.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

BASE = Path("/dev/shm")
_MODE = 0o700


def runtime_folder() -> Path:
    """This user's folder below `BASE`, mode 0700; it is made if it is missing.

    The parent is open to everybody, so another user may have taken the usual name. Then a folder with a random suffix
    is used, which every later call finds again by its owner.

    Raises:
        OSError: no such folder can be made, or other users can rename what lies in the parent.
    """
    about = BASE.stat()
    if about.st_uid not in (0, os.getuid()) or (about.st_mode & 0o022 and not about.st_mode & stat.S_ISVTX):
        raise PermissionError(f"{BASE}: other users can replace the files in it; expected mode 1777, owner root")
    name = f"softrig-{os.getuid()}"
    usual = BASE / name
    if is_private(usual):
        return usual
    for folder in sorted(BASE.glob(f"{name}.*")):
        if is_private(folder):
            return folder
    with suppress(FileExistsError):
        usual.mkdir(mode=_MODE)
    if is_private(usual):
        return usual
    import tempfile  # rarely needed, and slow to load for `rig vent`

    return Path(tempfile.mkdtemp(prefix=f"{name}.", dir=BASE))


def is_private(folder: Path) -> bool:
    """True for a folder, not a link to one, that belongs to this user and that no other user can enter."""
    try:
        about = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(about.st_mode) and about.st_uid == os.getuid() and not about.st_mode & 0o077


def subfolder(name: str) -> Path:
    """A folder inside `runtime_folder`. Raises OSError: it cannot be made, or is open to other users."""
    folder = runtime_folder() / name
    folder.mkdir(mode=_MODE, exist_ok=True)
    if not is_private(folder):
        raise PermissionError(f"{folder} must be a folder that only this user can enter: remove it")
    return folder


def open_private(path: Path, flags: int = os.O_RDWR) -> int:
    """Open a file of this user alone and return its descriptor; `flags` with O_CREAT makes it, mode 0600.

    Links are not followed, and a FIFO does not block.

    Raises:
        OSError: it cannot be opened.
        PermissionError: it is not a regular file, or other users own it, can write it or have a link to it.
    """
    descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o600)
    about = os.fstat(descriptor)
    if not stat.S_ISREG(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o022 or about.st_nlink > 1:
        os.close(descriptor)
        raise PermissionError(f"{path} is not a regular file that only this user can write: remove it")
    return descriptor
