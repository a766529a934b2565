"""A folder of this user below ~/.cache in which no other user can have put anything."""

from __future__ import annotations

import os
import stat
import time
from contextlib import suppress
from pathlib import Path


def folder(name: str) -> Path | None:
    """Return the folder ~/.cache/softrig/`name`, or that of $XDG_CACHE_HOME; it is made if it is missing.

    None where it cannot be written, or where another user can change it or put another one in its place.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111 - no home, no error
    place = home / "softrig" / name
    try:
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        return place if home.is_absolute() and is_own(place.resolve()) and os.access(place, os.W_OK) else None
    except OSError:
        return None


def is_own(place: Path) -> bool:
    """Whether a folder (without links) is this user's and no other user can change it or put another in its place.

    In a folder that everybody can write, as /tmp, only the owner can rename an entry, and only if it is sticky.
    """
    if not hasattr(os, "getuid"):  # Windows: the folders of a user are that user's own
        return True
    about = place.stat()
    if about.st_uid != os.getuid() or about.st_mode & stat.S_IWOTH:
        return False
    for parent in place.parents:
        above = parent.stat()
        if above.st_mode & stat.S_IWOTH and not (above.st_mode & stat.S_ISVTX and about.st_uid in (0, os.getuid())):
            return False
        about = above
    return True


def forget_old(place: Path, keep_s: float) -> None:
    """Remove the files of a folder that were not touched for some time."""
    before = time.time() - keep_s
    for file in place.iterdir():
        with suppress(OSError):
            if file.stat().st_mtime < before:
                file.unlink()
