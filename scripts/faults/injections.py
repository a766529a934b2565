"""The injections of the campaign: simulated bench, processes, disk, files, clock, terminal, model."""

from __future__ import annotations

import random
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from runs.records import Status
from scripts.faults import environment
from scripts.faults.environment import BlockedDisk, SteppedClock
from scripts.faults.fault import Fault, FaultTarget, Injection
from scripts.faults.trial_run import CONTROL, OBSERVER, SUPERVISOR, WATCHDOG, TrialRun

KILL, STOP = signal.SIGKILL, signal.SIGSTOP
BLOCKED_S = 8.0
"""How long a blocked terminal is not read."""


@dataclass(frozen=True)
class BenchFault(Injection):
    """Fields of the faults of the simulated bench (`rig.simulator.faults`)."""

    words: Mapping[str, float]

    def inject(self, target: FaultTarget) -> None:
        """Set the fields."""
        target.faults.inject(**self.words)


@dataclass(frozen=True)
class StopPressed(BenchFault):
    """The contact of an emergency stop opens."""

    def edit_rig(self, text: str) -> str:
        """Add an emergency stop at digital input 0."""
        text = text.replace("inputs: 16,", "inputs: 16, digital_inputs: 1,")
        return text.replace("\nlimits:\n", "\nemergency_stops: {button: {card: daq, channel: 0}}\n\nlimits:\n")


@dataclass(frozen=True)
class Signal(Injection):
    """A signal to processes of the run, all at once. They continue after `lasts_s`, or after the run if None."""

    processes: tuple[str, ...]
    number: signal.Signals
    lasts_s: float | None = None
    times: int = 1
    then_vent: bool = False
    """Run `rig vent` while they are stopped."""

    def inject_realtime(self, run: TrialRun) -> int | None:
        """Send the signal `times` times; with `then_vent`, return the start of `rig vent`."""
        for _ in range(self.times):
            run.signal(self.processes, self.number)
            if self.lasts_s is None:
                return None
            if self.then_vent:
                begun = time.monotonic_ns()
                command = [sys.executable, "-P", "-m", "rig", "vent", "--rig", str(run.rig_file)]
                subprocess.run(command, check=True, capture_output=True)
                time.sleep(self.lasts_s)
                run.signal(self.processes, signal.SIGCONT)
                return begun
            timer = threading.Timer(self.lasts_s, run.signal, (self.processes, signal.SIGCONT))
            timer.start()
            if self.times > 1:
                timer.join()
                time.sleep(0.004)
        return None


@dataclass(frozen=True)
class ProcessSignal:
    """One signal to a process, `wait_s` after the one before it."""

    process: str
    number: signal.Signals
    wait_s: float


@dataclass(frozen=True)
class SignalSequence(Injection):
    """Signals to processes one after the other; stopped processes continue after `lasts_s`."""

    signals: tuple[ProcessSignal, ...]
    lasts_s: float

    def inject_realtime(self, run: TrialRun) -> None:
        """Send the signals."""
        for sent in self.signals:
            time.sleep(sent.wait_s)
            run.signal((sent.process,), sent.number)
        stopped = tuple(sent.process for sent in self.signals if sent.number == STOP)
        threading.Timer(self.lasts_s, run.signal, (stopped, signal.SIGCONT)).start()


@dataclass(frozen=True)
class RandomProcessSignals(Injection):
    """One to three of the four processes that can make the valves safe, one after the other in any order.

    Each gets one of `numbers`; stopped processes continue after `lasts_s`.
    """

    numbers: tuple[signal.Signals, ...]
    lasts_s: float = 4.0

    def decided(self, fault: Fault, chance: random.Random) -> Fault:
        """The fault with a sequence of signals and its expected result; a killed supervisor reports nothing."""
        four = (CONTROL, WATCHDOG, SUPERVISOR, OBSERVER)
        chosen = chance.sample(four, chance.randint(1, len(four) - 1))
        signals = tuple(ProcessSignal(name, chance.choice(self.numbers), chance.uniform(0, 0.05)) for name in chosen)
        injection = SignalSequence(signals, self.lasts_s)
        if any(sent.process == SUPERVISOR and sent.number == KILL for sent in signals):
            return replace(fault, injection=injection, ends=(Status.RECOVERED,), says="")
        return replace(fault, injection=injection, ends=(Status.ABORTED,))


@dataclass(frozen=True)
class DiskFull(Injection):
    """The disk of the archive is full."""

    def prepared(self, folder: Path, stack: ExitStack) -> Injection:
        """Give the archive a small file system of its own."""
        stack.enter_context(environment.small_disk(folder / "out"))
        return self

    def inject(self, target: FaultTarget) -> None:
        """Fill it."""
        environment.fill(target.out)


@dataclass(frozen=True)
class FileLimit(Injection):
    """The journal reaches the limit of the size of a file."""

    def inject_realtime(self, run: TrialRun) -> None:
        """Set the limit to the present size."""
        environment.limit_files(run.process.pid, next(run.out.glob("*.mcap")))


@dataclass(frozen=True)
class FolderReadOnly(Injection):
    """The folder of the archive becomes read-only."""

    def inject_realtime(self, run: TrialRun) -> None:
        """Make it read-only until the run has ended."""
        run.undo.enter_context(environment.read_only(run.out))


@dataclass(frozen=True)
class FilesChanged(Injection):
    """The rig file and the protocol change during the run."""

    def inject(self, target: FaultTarget) -> None:
        """Overwrite both."""
        target.rig_file.write_text("spoilt: [")
        target.protocol.write_text("spoilt: [")


@dataclass(frozen=True)
class ClockStep(Injection):
    """The calendar clock steps by `step_ns`."""

    step_ns: int
    clock: SteppedClock | None = None

    @property
    def environment(self) -> Mapping[str, str]:
        """Preloads the clock."""
        return self.clock.environment if self.clock else {}

    def prepared(self, folder: Path, stack: ExitStack) -> Injection:
        """Build the clock."""
        return replace(self, clock=SteppedClock(folder))

    def inject_realtime(self, run: TrialRun) -> None:
        """Step the clock."""
        assert self.clock is not None
        self.clock.require(run.members.values())
        self.clock.step(self.step_ns)


@dataclass(frozen=True)
class DiskBlocked(Injection):
    """The disk blocks for `lasts_s`."""

    lasts_s: float
    disk: BlockedDisk | None = None

    @property
    def environment(self) -> Mapping[str, str]:
        """Preloads the disk."""
        return self.disk.environment if self.disk else {}

    def prepared(self, folder: Path, stack: ExitStack) -> Injection:
        """Build the disk."""
        return replace(self, disk=BlockedDisk(folder))

    def inject_realtime(self, run: TrialRun) -> None:
        """Block it."""
        assert self.disk is not None
        self.disk.require(run.members.values())
        self.disk.block(self.lasts_s)


@dataclass(frozen=True)
class TerminalBlocked(Injection):
    """The terminal takes no output for a time."""

    terminal: ClassVar[bool] = True

    def inject_realtime(self, run: TrialRun) -> None:
        """Read nothing for BLOCKED_S."""
        run.turn_away()
        threading.Timer(BLOCKED_S, run.turn_back).start()


@dataclass(frozen=True)
class TerminalLost(Injection):
    """The terminal is closed."""

    terminal: ClassVar[bool] = True

    def inject_realtime(self, run: TrialRun) -> None:
        """Close it."""
        run.hang_up()


@dataclass(frozen=True)
class ModelUnsolvable(Injection):
    """The model of the arm has no solution."""

    def edit_rig(self, text: str) -> str:
        """A rig with a far too heavy and too soft arm."""
        text = text.replace("  cap_mass_g: 50\n", "  cap_mass_g: 5000\n")
        return re.sub(r"a1_per_N: [\d.]+", "a1_per_N: 10.0", text, count=1)
