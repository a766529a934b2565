"""Locks of real cards: one run per card; the kernel releases the locks of a dead process.

The lock of a card is a file in its user's runtime folder. A card is shared by the users who may open its device node,
so the node itself is locked as well: other users cannot forge that lock. The holder of a lock is read from the kernel's
table, never from the content of a file. A simulated card needs no lock: each run has its own.
"""

from __future__ import annotations

import errno
import fcntl
import os
import pwd
import re
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from rig.config.bench import BenchConfig, VentedBench
from rig.config.card_sections import CardConfig
from rig.config.drivers import Reality
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.cards.kernel_devices import boards_called
from rig.hardware.running import RunningRig, recorded, records
from rig.hardware.runtime_folder import open_private, runtime_folder

LOCKS = Path("/proc/locks")
_COMMAND_LENGTH = 120


def lock_file(card: CardConfig) -> Path:
    """This user's lock file of a card; the same file for every name of the card.

    Raises:
        OSError: this user's runtime folder cannot be made.
    """
    name = "".join(c if c.isalnum() else "-" for c in f"{card.driver}-{device_of(card)}")
    return runtime_folder() / f"{name}.lock"


def device_node(card: CardConfig) -> Path:
    """The device node behind a symbolic link or a board's name; the name itself if it does not identify one card."""
    if card.device.startswith("/"):
        return Path(os.path.realpath(card.device))
    found = boards_called(card.device)
    return Path(found[0].node if len(found) == 1 else card.device)


def outputs_of(config: BenchConfig) -> set[tuple[str, str, int]]:
    """The outputs of the valves of a rig, each by driver, device and channel; the same for every name of the card."""
    cards = {name: (card.driver, device_of(card)) for name, card in config.cards.items()}
    return {(*cards[valve.card], valve.channel) for valve in config.valves}


def device_of(card: CardConfig) -> str:
    """The device of a card; the same for every name of it."""
    return card.device if card.reality is Reality.SIMULATED else os.fspath(device_node(card))


def holders(config: BenchConfig) -> tuple[int, ...]:
    """Processes that hold the rig: the lock of a real card, by any user, or a simulated card of a run of this user.

    Those that this process can see.
    """
    files = set()
    for path in (place for card in config.cards.values() for place in _places(card)):
        with suppress(OSError):
            files.add(_identity(path.stat()))
    pids = {pid for pid, file in _locks() if file in files}
    if simulated := {card.device for card in config.cards.values() if card.reality is Reality.SIMULATED}:
        runs, _ = records()
        pids |= {run.process.pid for run in runs if run.process.alive and simulated & _devices(run)}
    return tuple(sorted(pids))


def runs_of(config: BenchConfig) -> tuple[RunningRig, ...]:
    """The runs of this user on the simulated cards of a rig file: each has its own."""
    named = {card.device for card in config.cards.values() if card.reality is Reality.SIMULATED}
    runs, _ = records()
    return tuple(run for run in runs if {_in_rig_file(device, run.process.pid) for device in _devices(run)} & named)


def _devices(run: RunningRig) -> set[str]:
    """The simulated cards of a run."""
    with suppress(AttributeError, KeyError, TypeError):
        return {card["device"] for card in run.bench["cards"].values() if card["driver"] == "mock"}
    return set()


def _in_rig_file(device: str, pid: int) -> str:
    """The name of a simulated card in the rig file of a run, which added its process id."""
    return re.sub(rf"-{pid}(-\d+)?$", "", device)


def held_by_unseen(config: BenchConfig) -> bool:
    """True if a card is locked by a process that this one cannot see, such as one in another container."""
    if holders(config):
        return False
    for card in config.cards.values():
        for path in _places(card):
            try:
                descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            except OSError:
                continue
            try:
                fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                # The lock may have been taken since the table was read.
                if not holders(config):
                    return True
            finally:
                os.close(descriptor)
    return False


def described(pid: int) -> str:
    """Description of a process from the kernel's data: id, user, command and start time."""
    try:
        folder = Path(f"/proc/{pid}")
        uid = folder.stat().st_uid
        command = (folder / "cmdline").read_bytes().rstrip(b"\0").replace(b"\0", b" ").decode(errors="replace")
        ticks = int((folder / "stat").read_text(errors="replace").rsplit(")", 1)[1].split()[19])
    except (OSError, IndexError, ValueError):
        return f"process {pid}"
    age_s = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    since = datetime.fromtimestamp(time.time() - age_s).astimezone().isoformat(timespec="seconds")
    try:
        user = pwd.getpwuid(uid).pw_name
    except KeyError:
        user = str(uid)
    shown = "".join(c if c.isprintable() else "?" for c in command[:_COMMAND_LENGTH])
    return f"process {pid} of user {user} ({shown}), since {since}"


@contextmanager
def cards_locked(config: BenchConfig, purpose: str) -> Iterator[None]:
    """Lock every real card of the rig, and record the run for `rig vent`.

    Raises:
        CardError: another run holds a card; the message names the process and its start time.
    """
    held: list[int] = []
    try:
        for name, card in sorted(config.cards.items()):
            if card.reality is not Reality.SIMULATED:
                _lock(name, card, config, held)
        bench = VentedBench.of(config).model_dump(mode="json", exclude_none=True)
        with recorded(
            purpose,
            config.name,
            simulated=all(card.reality is Reality.SIMULATED for card in config.cards.values()),
            bench=bench,
        ):
            yield
    finally:
        for descriptor in held:
            os.close(descriptor)


def locked_devices() -> tuple[tuple[Path, int], ...]:
    """Comedi device nodes that are locked by a process of any user, with its id."""
    nodes = {}
    for path in sorted(Path("/dev").glob("comedi[0-9]*")):
        with suppress(OSError):
            nodes[_identity(path.stat())] = path
    return tuple((nodes[file], pid) for pid, file in _locks() if file in nodes)


def _places(card: CardConfig) -> tuple[Path, ...]:
    """Files that are locked for a card; a simulated one has none."""
    if card.reality is Reality.SIMULATED:
        return ()
    places = [device_node(card)]
    with suppress(OSError):
        places.append(lock_file(card))
    return tuple(places)


def _lock(name: str, card: CardConfig, config: BenchConfig, held: list[int]) -> None:
    """Lock one card; the descriptors that must stay open are added to `held`."""
    try:
        path = lock_file(card)
        held.append(open_private(path, os.O_RDWR | os.O_CREAT))
    except OSError as error:
        raise CardError(f"the lock of card '{name}' cannot be opened: {_reason(error)}") from error
    _take(held[-1], name, card, config)
    node = device_node(card)
    # A board name that does not identify one card is refused when the card is opened.
    if not node.is_absolute():
        return
    descriptor = _open_node(name, node)
    held.append(descriptor)
    _take(descriptor, name, card, config)
    try:
        os.close(_open_node(name, node))
    except CardBusyError:
        # A driver that allows one process only excludes others by itself; the open node would exclude control, too.
        held.remove(descriptor)
        os.close(descriptor)


def _open_node(name: str, node: Path) -> int:
    try:
        descriptor = os.open(node, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        from rig.hardware.cards.comedi_device import why_closed

        if error.errno == errno.EBUSY:
            raise why_closed(os.fspath(node), error) from None
        failure = why_closed(os.fspath(node), error)
        raise CardError(f"card '{name}': {failure.what}", failure.remedy) from None
    if not stat.S_ISCHR(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise CardError(f"card '{name}': {node} is not a device node")
    return descriptor


def _take(descriptor: int, name: str, card: CardConfig, config: BenchConfig) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        others = [pid for pid in holders(config) if pid != os.getpid()]
        by = ", ".join(map(described, others)) or "a process that this one cannot see"
        raise CardError(
            f"card '{name}' ({card.device}) is in use by another run: {by}. "
            "Wait for it to end, stop it, or make everything safe with `rig vent --rig` and this rig."
        ) from None


def _locks() -> Iterator[tuple[int, tuple[int, int, int]]]:
    """Holder and file (major, minor, inode) of every flock in the kernel's table."""
    try:
        lines = LOCKS.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        words = line.split()
        # A line with an arrow is a waiting process.
        if len(words) < 6 or words[1] != "FLOCK":
            continue
        with suppress(ValueError):
            major, minor, inode = words[5].split(":")
            yield int(words[4]), (int(major, 16), int(minor, 16), int(inode))


def _identity(about: os.stat_result) -> tuple[int, int, int]:
    return os.major(about.st_dev), os.minor(about.st_dev), about.st_ino


def _reason(error: OSError) -> str:
    return f"{error.filename}: {error.strerror}" if error.strerror else str(error)
