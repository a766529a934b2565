"""One run per card: an advisory lock that names its owner and that the kernel releases when the owner dies."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from rig.config import RigConfig
from rig.daq.base import CardError


def lock_file(driver: str, device: str) -> Path:
    """Where the lock of a device lies: one place for all users of the machine."""
    name = "".join(c if c.isalnum() else "-" for c in f"{driver}-{device}")
    return Path(tempfile.gettempdir()) / f"softrig-{name}.lock"


@contextmanager
def cards_locked(config: RigConfig, purpose: str) -> Iterator[None]:
    """Hold every card of the rig.

    Raises:
        CardError: another run holds one; the message says who and since when.
    """
    held: list[int] = []
    try:
        for name, card in sorted(config.cards.items()):
            path = lock_file(card.driver, card.device)
            try:
                fd = _open(path)
            except OSError as error:
                raise CardError(f"{path}: the lock of card '{name}' cannot be opened: {error.strerror}") from error
            held.append(fd)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                owner = os.pread(fd, 500, 0).decode(errors="replace").strip() or "unknown"
                raise CardError(
                    f"card '{name}' ({card.device}) is in use by another run: {owner}. "
                    "Wait for it to end, stop it, or make everything safe with `rig vent`."
                ) from None
            os.ftruncate(fd, 0)
            since = datetime.now().astimezone().isoformat(timespec="seconds")
            os.pwrite(fd, f"process {os.getpid()}, {purpose}, since {since}\n".encode(), 0)
        yield
    finally:
        for fd in held:
            os.close(fd)


def _open(path: Path) -> int:
    """Open a lock for any user; O_CREAT on another user's file in a sticky folder is refused by the kernel."""
    try:
        return os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        with contextlib.suppress(PermissionError):
            os.fchmod(fd, 0o666)
        return fd
