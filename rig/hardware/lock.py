"""One run per card: an advisory lock that names its owner and that the kernel releases when the owner dies."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from rig.config.schema import CardConfig, RigConfig
from rig.hardware.cards.base import CardError
from rig.hardware.cards.kernel_devices import comedi

FOLDER = Path("/tmp")
"""Where every program of the machine finds the locks, whatever folder it keeps its own temporary files in."""


def lock_file(card: CardConfig) -> Path:
    """Where the lock of a card lies: one place, by whatever name a rig calls the card.

    A mock card is its user's alone, as the file behind it is.
    """
    device = f"{os.getuid()}-{card.device}" if card.simulated else _node(card.device)
    name = "".join(c if c.isalnum() else "-" for c in f"{card.driver}-{device}")
    return (FOLDER if FOLDER.is_dir() else Path(tempfile.gettempdir())) / f"softrig-{name}.lock"


def _node(device: str) -> str:
    """The device node behind a symbolic link or a board's name; the name itself where it stands for no one card."""
    if device.startswith("/"):
        return os.path.realpath(device)
    known = comedi()
    minors = [card.minor for card in known.attached if card.board.casefold() == device.casefold()] if known else []
    return f"/dev/comedi{minors[0]}" if len(minors) == 1 else device


def holders(config: RigConfig) -> tuple[int, ...]:
    """Processes that hold a card of the rig, as far as this user may see them."""
    found = []
    for card in config.cards.values():
        path = lock_file(card)
        with contextlib.suppress(OSError):
            named = re.match(r"process (\d+),", path.read_text(errors="replace"))
            # What is written there may be left over; who holds the lock has the file open.
            if named and _has_open(int(named[1]), path):
                found.append(int(named[1]))
    return tuple(found)


def _has_open(pid: int, path: Path) -> bool:
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            if link.samefile(path):
                return True
    return False


@contextmanager
def cards_locked(config: RigConfig, purpose: str) -> Iterator[None]:
    """Hold every card of the rig.

    Raises:
        CardError: another run holds one; the message says who and since when.
    """
    held: list[int] = []
    try:
        for name, card in sorted(config.cards.items()):
            path = lock_file(card)
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
                    "Wait for it to end, stop it, or make everything safe with `rig vent --rig` and this rig."
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
