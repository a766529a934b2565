"""Records of running experiments: their processes and their bench, from which `rig vent` ends and vents them.

Standard library only: `rig vent` signals the running experiments before it imports anything else. A record holds what
the safe state needs, so that no file of the user can keep a running experiment from being vented. It is in a folder
that only its user can write. Its name has the process id and the start time of the process, so that a process that has
got the same id later is not taken for the run.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.execution.stop_signals import VENT_SIGNAL
from rig.hardware.runtime_folder import open_private, subfolder

FOLDER = "rigs"
_MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class Process:
    """A process by its id and its start time [clock ticks since boot]."""

    pid: int
    start: int

    @classmethod
    def of(cls, pid: int) -> Process:
        """A process that runs. Raises OSError: there is none."""
        return cls(pid, _start(pid))

    @property
    def alive(self) -> bool:
        """True while this process runs, also if it is stopped."""
        try:
            return _start(self.pid) == self.start and not _is_zombie(self.pid)
        except OSError:
            return False

    def send(self, number: signal.Signals) -> bool:
        """Send it a signal, if it runs; False if this user may not."""
        if self.alive:
            try:
                os.kill(self.pid, number)
            except ProcessLookupError:
                pass
            except PermissionError:
                return False
        return True


@dataclass(frozen=True)
class RunningRig:
    """The record of a run: its main process, what it does, and what `rig vent` needs of its rig.

    `listeners` vent at VENT_SIGNAL. `bench` is a `rig.config.bench.VentedBench` as JSON.
    """

    file: Path
    process: Process
    purpose: str
    rig: str
    simulated: bool
    listeners: tuple[Process, ...]
    bench: Mapping[str, Any]

    @property
    def alive(self) -> bool:
        """True while a process of the run lives that may write to the cards."""
        return any(process.alive for process in (self.process, *self.listeners))


@dataclass(frozen=True)
class UnreadableRecord:
    """A record that cannot be read, and why; its name still tells the process."""

    file: Path
    process: Process
    reason: str

    @property
    def alive(self) -> bool:
        """True while the process in its name lives."""
        return self.process.alive


def records() -> tuple[tuple[RunningRig, ...], tuple[UnreadableRecord, ...]]:
    """The records of this user: readable ones, and those that are not.

    Also those of runs whose main process has been killed: their valves may still be open.
    """
    read: list[RunningRig] = []
    unreadable: list[UnreadableRecord] = []
    try:
        files = sorted(subfolder(FOLDER).glob("*.json"))
    except OSError as error:
        return (), (UnreadableRecord(Path(FOLDER), Process(0, 0), str(error)),)
    for file in files:
        process = _process_of(file)
        try:
            read.append(_read(file, process))
        except FileNotFoundError:
            continue  # the run has ended since
        except (OSError, ValueError, KeyError, TypeError) as error:
            unreadable.append(UnreadableRecord(file, process, f"{type(error).__name__}: {error}"))
    return tuple(read), tuple(unreadable)


def chosen(runs: tuple[RunningRig, ...], *, simulated: bool) -> tuple[RunningRig, ...]:
    """The runs that `rig vent` ends without a rig that is named: those on real devices, else the simulated ones.

    With `simulated` both. A run that has been killed counts.
    """
    real = tuple(run for run in runs if not run.simulated)
    return runs if simulated or not real else real


@dataclass(frozen=True)
class Signalled:
    """The runs that were told to vent, and the records that could not be read."""

    runs: tuple[RunningRig, ...]
    unreadable: tuple[UnreadableRecord, ...]


def signal_runs(*, simulated: bool = False) -> Signalled:
    """Have the processes of the running experiments vent: the first act of `rig vent`.

    A run whose record cannot be read is asked to end.
    """
    runs, unreadable = records()
    told = chosen(runs, simulated=simulated)
    for run in told:
        signal_run(run)
    for record in unreadable:
        record.process.send(signal.SIGTERM)
    return Signalled(told, unreadable)


def signal_run(run: RunningRig) -> None:
    """Have the processes of one run vent."""
    for process in run.listeners:
        process.send(VENT_SIGNAL)


_first: list[Signalled] = []
ALL = "--all"


def first_act(arguments: Sequence[str]) -> None:
    """Signal the running experiments if these are the arguments of `rig vent`, before anything is imported."""
    if arguments[:1] == ["vent"] and "--help" not in arguments:
        _first.append(signal_runs(simulated=ALL in arguments))


def signalled(*, simulated: bool) -> Signalled:
    """What `first_act` has signalled, as the runs may have ended since; else signal them."""
    return _first.pop() if _first else signal_runs(simulated=simulated)


class Record:
    """The record of a run of this process, which names more processes as they start."""

    def __init__(self, purpose: str, rig: str, *, simulated: bool, bench: Mapping[str, Any]) -> None:
        process = Process.of(os.getpid())
        numbers = itertools.count()
        folder = subfolder(FOLDER)
        self._facts = {"purpose": purpose, "rig": rig, "simulated": simulated, "bench": bench}
        self._listeners: list[Process] = []
        self.file = next(
            file for number in numbers if not (file := folder / f"{process.pid}-{process.start}-{number}.json").exists()
        )
        # The main process listens if it has a handler; in a notebook it has none.
        if signal.getsignal(VENT_SIGNAL) not in (signal.SIG_DFL, signal.SIG_IGN, None):
            self._listeners.append(process)
        self._write()

    def add(self, pid: int) -> None:
        """Name a process that vents at VENT_SIGNAL; it may still hold that signal back."""
        with suppress(OSError):
            self._listeners.append(Process.of(pid))
            self._write()

    def remove(self) -> None:
        """The run has ended, its valves are safe."""
        with suppress(OSError):
            self.file.unlink(missing_ok=True)

    def _write(self) -> None:
        # Replaced as a whole: a reader never finds half a record.
        new = self.file.with_suffix(".new")
        new.unlink(missing_ok=True)
        listeners = [[process.pid, process.start] for process in self._listeners]
        with os.fdopen(open_private(new, os.O_RDWR | os.O_CREAT | os.O_EXCL), "w", encoding="utf-8") as file:
            json.dump({**self._facts, "listeners": listeners}, file)
        new.replace(self.file)


_current: ContextVar[Record | None] = ContextVar("record", default=None)


@contextmanager
def recorded(purpose: str, rig: str, *, simulated: bool, bench: Mapping[str, Any]) -> Iterator[None]:
    """Record a run while it lasts. A record that cannot be written does not prevent a run."""
    record: Record | None = None
    with suppress(OSError):
        record = Record(purpose, rig, simulated=simulated, bench=bench)
    token = _current.set(record)
    try:
        yield
    finally:
        _current.reset(token)
        if record is not None:
            record.remove()


def listens(pid: int) -> None:
    """Name a process of this thread's run that vents at VENT_SIGNAL."""
    if (record := _current.get()) is not None:
        record.add(pid)


@contextmanager
def vent_signal_held_back() -> Iterator[None]:
    """Let a process that is started inside hold VENT_SIGNAL back until it listens: it would end the process before."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {VENT_SIGNAL})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _process_of(file: Path) -> Process:
    try:
        pid, start, *_ = (int(part) for part in file.stem.split("-"))
    except ValueError:
        return Process(0, 0)
    return Process(pid, start)


def _read(file: Path, process: Process) -> RunningRig:
    with os.fdopen(open_private(file, os.O_RDONLY), "rb") as opened:
        facts = json.loads(opened.read(_MOST_BYTES))
    listeners = tuple(Process(int(pid), int(start)) for pid, start in facts["listeners"])
    if not isinstance(facts["bench"], dict) or not process.pid:
        raise ValueError("not the record of a run")
    purpose, rig = str(facts["purpose"]), str(facts["rig"])
    return RunningRig(file, process, purpose, rig, bool(facts["simulated"]), listeners, facts["bench"])


def _stat(pid: int) -> list[str]:
    # The name of a process is in parentheses, and may contain any character.
    return Path(f"/proc/{pid}/stat").read_text(errors="replace").rsplit(")", 1)[1].split()


def _start(pid: int) -> int:
    return int(_stat(pid)[19])


def _is_zombie(pid: int) -> bool:
    return _stat(pid)[0] == "Z"
