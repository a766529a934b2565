"""One trial in real time: a `rig run` with a fault at a given moment, observed through its mock card's registers."""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import re
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import rig.config.loader
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import safe_voltages
from rig.simulator.registers import Registers, path_of
from scripts.faults import environment
from scripts.faults.catalogue import (
    ABORTED,
    CONTROL,
    KILL,
    MOVING_S,
    OBSERVER,
    PLANT,
    RECOVERED,
    STOP,
    SUPERVISOR,
    WATCHDOG,
    BenchFault,
    DiskBlocked,
    EnvironmentFault,
    Fault,
    RandomProcessSignals,
    Signal,
)
from scripts.faults.environment import BlockedDisk, SteppedClock, UnsupportedFaultError
from scripts.faults.fault_trial import PROTOCOL, EndedBeforeError, FaultTrial, TrialObservation, judge, skipped
from scripts.faults.virtual import SEEN_SAFE_V, rig_text

MODULES = {
    CONTROL: "rig.realtime.control_process",
    WATCHDOG: "rig.realtime.watchdog_process",
    OBSERVER: "rig.realtime.observer_process",
    PLANT: "rig.simulator.plant_process",
}
START_S, END_S = 200.0, 45.0
ENDED_S = 0.3
"""How long the registers are watched on once the run has ended."""
MOVING_V = 4.0
STILL_S = 0.1


class TrialRun:
    """A `rig run` in a process of its own: its processes, its output, and the voltages of its valves."""

    def __init__(
        self,
        folder: Path,
        action: object,
        environment: dict[str, str],
        protocol: str = PROTOCOL.format(moving_s=MOVING_S),
        limits: dict[str, float] | None = None,
    ) -> None:
        """Start it; `limits` are some of the rig's that are to be others."""
        self.out = folder / "out"
        self.rig_file, self.protocol = folder / "rig.yaml", folder / "protocol.yaml"
        self.device = f"faults-{os.getpid()}-{threading.get_native_id()}"
        self.rig_file.write_text(_limited(rig_text(action, self.device), limits or {}))
        self.protocol.write_text(protocol)
        self._safe_v = np.array(safe_voltages(rig.config.loader.load(self.rig_file)))
        self._said: list[bytes] = []
        self._listening = threading.Event()
        self._listening.set()
        command = [sys.executable, "-P", "-m", "rig", "run", str(self.protocol), "--rig", str(self.rig_file)]
        command += ["--out", str(self.out), "--yes", "--no-report"]
        on_screen = action in (EnvironmentFault.TERMINAL_BLOCKED, EnvironmentFault.TERMINAL_LOST)
        self.screen, inner = os.openpty() if on_screen else os.pipe()
        if on_screen:
            fcntl.ioctl(inner, termios.TIOCSWINSZ, np.array([40, 100, 0, 0], np.uint16).tobytes())
        self.process = subprocess.Popen(
            command,
            stdin=inner if on_screen else subprocess.DEVNULL,
            stdout=inner,
            stderr=inner,
            start_new_session=not on_screen,
            preexec_fn=(lambda: os.login_tty(os.dup(inner))) if on_screen else None,
            env=os.environ | environment,
        )
        os.close(inner)
        threading.Thread(target=self._listen, daemon=True).start()
        self.members: dict[str, int] = {}

    @property
    def said(self) -> str:
        """Everything printed so far."""
        return b"".join(self._said).decode(errors="replace").replace("\r", "")

    def turn_away(self) -> None:
        """Stop reading what the run prints."""
        self._listening.clear()

    def turn_back(self) -> None:
        """Read on."""
        self._listening.set()

    def hang_up(self) -> None:
        """Close the terminal."""
        self._listening.clear()
        time.sleep(0.1)
        os.close(self.screen)
        self.screen = -1

    def _listen(self) -> None:
        while self.screen >= 0:
            if not self._listening.is_set():
                time.sleep(0.02)
                continue
            try:
                if not select.select([self.screen], [], [], 0.05)[0]:
                    continue
                data = os.read(self.screen, 65536)
            except (OSError, ValueError):
                return
            if not data:
                return
            self._said.append(data)

    def wait_until_moving(self) -> Registers:
        """Return the card's registers once the run drives a valve, with every member of the run known."""
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline and self.process.poll() is None:
            registers = self.attached()
            if registers is not None:
                if np.any(registers.outputs["volts"] > MOVING_V):
                    self.members = {SUPERVISOR: self.process.pid} | children(self.process.pid)
                    return registers
                registers.close()
            time.sleep(0.02)
        raise RuntimeError(f"the run never drove a valve: {self.said}")

    def attached(self) -> Registers | None:
        """The card's registers, None as long as there are none."""
        try:
            return Registers.attach(self.device)
        except CardError:  # not there yet, or not yet complete
            return None

    def ended(self, registers: Registers) -> bool:
        """True where the run is over: it has left, or its valves are safe and stay so for longer than they ever do."""
        until = time.monotonic() + STILL_S
        while self.process.poll() is None:
            if not self.safe(registers):
                return False
            if time.monotonic() > until:
                return True
            time.sleep(0.001)
        return True

    def safe(self, registers: Registers) -> bool:
        """True while every output stands at its safe voltage."""
        volts = registers.outputs["volts"][: len(self._safe_v)]
        return bool(np.all(np.abs(volts - self._safe_v) < SEEN_SAFE_V))

    def watch(self, registers: Registers) -> int | None:
        """Follow the outputs until the run has ended; since when [ns] they have been safe, None where they are not."""
        safe_ns: int | None = None
        deadline = time.monotonic() + END_S
        ended = 0.0
        while (now := time.monotonic()) < deadline:
            if not self.safe(registers):
                safe_ns = None
            elif safe_ns is None:
                safe_ns = int(registers.outputs["written_ns"].max())
            if self.process.poll() is not None:
                ended = ended or now
                left = [name for name in (WATCHDOG, CONTROL, OBSERVER) if lives(self.members[name])]
                if now - ended > ENDED_S and not left:
                    break
            time.sleep(0.001)
        return safe_ns

    def signal(self, names: tuple[str, ...], number: signal.Signals) -> None:
        """Send a signal to members, one right after the other."""
        for name in names:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.members[name], number)

    def close(self) -> None:
        """Leave nothing behind."""
        self._listening.set()
        for pid in (*self.members.values(), self.process.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        if self.screen >= 0:
            screen, self.screen = self.screen, -1
            time.sleep(0.1)
            os.close(screen)
        path_of(self.device).unlink(missing_ok=True)


class OutputMonitor(threading.Thread):
    """Watches the outputs of a run from now on."""

    def __init__(self, run: TrialRun, registers: Registers) -> None:
        super().__init__(daemon=True)
        self._run, self._registers = run, registers
        self._safe_ns: int | None = None
        self.start()

    def run(self) -> None:
        """Monitor until the run ends."""
        self._safe_ns = self._run.watch(self._registers)

    def result(self) -> int | None:
        """Since when the outputs have been safe [ns], once the run has ended."""
        self.join()
        return self._safe_ns


@contextmanager
def _run(folder: Path, fault: Fault, environment: dict[str, str]) -> Iterator[TrialRun]:
    run = TrialRun(folder, fault.action, environment, PROTOCOL.format(moving_s=fault.moving_s))
    try:
        yield run
    finally:
        run.close()


def trial(fault: Fault, folder: Path, at_s: float, seed: int) -> FaultTrial:
    """Run one trial in real time."""
    fault, signals = _decided(fault, random.Random(seed))
    out = folder / "out"
    out.mkdir()
    variables: dict[str, str] = {}
    try:
        with ExitStack() as stack:
            if fault.action is EnvironmentFault.DISK_FULL:
                stack.enter_context(environment.small_disk(out))
            steered: SteppedClock | BlockedDisk | None = None
            if fault.action in (EnvironmentFault.CLOCK_FORWARD, EnvironmentFault.CLOCK_BACK):
                steered = SteppedClock(folder)
            elif isinstance(fault.action, DiskBlocked):
                steered = BlockedDisk(folder)
            if steered is not None:
                variables = steered.environment
            with _run(folder, fault, variables) as run, ExitStack() as undo:
                registers = run.wait_until_moving()
                time.sleep(at_s)
                if run.ended(registers):
                    run.process.wait(END_S)
                    raise EndedBeforeError(run.said[-1500:])
                watch = OutputMonitor(run, registers)
                fault_ns = time.monotonic_ns()
                fault_ns = _inject(fault, signals, run, registers, steered, undo) or fault_ns
                safe_ns = watch.result()
                registers.close()
                undo.close()
                time.sleep(0.1)
                said = run.said
            with contextlib.suppress(FileNotFoundError):
                (out / "filler").unlink()
            return judge(fault, "real", at_s, TrialObservation(fault_ns, safe_ns, said), out)
    except UnsupportedFaultError as why:
        return skipped(fault, "real", at_s, str(why))


@dataclass(frozen=True)
class ProcessSignal:
    """One signal to a process, `wait_s` after the one before it."""

    process: str
    number: signal.Signals
    wait_s: float


def _decided(fault: Fault, chance: random.Random) -> tuple[Fault, tuple[ProcessSignal, ...]]:
    """Return the fault with its expected result, and its random signals; a dead supervisor reports nothing."""
    if not isinstance(fault.action, RandomProcessSignals):
        return fault, ()
    four = (CONTROL, WATCHDOG, SUPERVISOR, OBSERVER)
    chosen = chance.sample(four, chance.randint(1, len(four) - 1))
    signals = tuple(
        ProcessSignal(name, chance.choice(fault.action.numbers), chance.uniform(0, 0.05)) for name in chosen
    )
    if any(sent.process == SUPERVISOR and sent.number == KILL for sent in signals):
        return replace(fault, ends=RECOVERED, says=""), signals
    return replace(fault, ends=ABORTED), signals


def _inject(
    fault: Fault,
    signals: tuple[ProcessSignal, ...],
    run: TrialRun,
    registers: Registers,
    steered: SteppedClock | BlockedDisk | None,
    undo: ExitStack,
) -> int | None:
    """Inject the fault; return when the time to the safe state begins if that is later than the call."""
    match fault.action:
        case BenchFault(words):
            registers.faults.inject(**words)
        case Signal() as action:
            return _signal(action, run)
        case RandomProcessSignals(lasts_s=lasts_s):
            for sent in signals:
                time.sleep(sent.wait_s)
                run.signal((sent.process,), sent.number)
            stopped = tuple(sent.process for sent in signals if sent.number == STOP)
            threading.Timer(lasts_s, run.signal, (stopped, signal.SIGCONT)).start()
        case EnvironmentFault.DISK_FULL:
            environment.fill(run.out)
        case EnvironmentFault.FILE_LIMIT:
            environment.limit_files(run.process.pid, next(run.out.glob("*.mcap")))
        case EnvironmentFault.FOLDER_READ_ONLY:
            undo.enter_context(environment.read_only(run.out))
        case EnvironmentFault.FILES_CHANGED:
            run.rig_file.write_text("spoilt: [")
            run.protocol.write_text("spoilt: [")
        case EnvironmentFault.CLOCK_FORWARD | EnvironmentFault.CLOCK_BACK:
            assert isinstance(steered, SteppedClock)
            steered.require(run.members.values())
            steered.step(environment.DAY_NS if fault.action is EnvironmentFault.CLOCK_FORWARD else -environment.DAY_NS)
        case DiskBlocked(lasts_s=lasts_s):
            assert isinstance(steered, BlockedDisk)
            steered.require(run.members.values())
            steered.stand(lasts_s)
        case EnvironmentFault.TERMINAL_BLOCKED:
            run.turn_away()
            threading.Timer(8.0, run.turn_back).start()
        case EnvironmentFault.TERMINAL_LOST:
            run.hang_up()
    return None


def _signal(action: Signal, run: TrialRun) -> int | None:
    for _ in range(action.times):
        run.signal(action.processes, action.number)
        if action.lasts_s is None:
            return None
        if action.then_vent:
            begun = time.monotonic_ns()
            command = [sys.executable, "-P", "-m", "rig", "vent", "--rig", str(run.rig_file)]
            subprocess.run(command, check=True, capture_output=True)
            time.sleep(action.lasts_s)
            run.signal(action.processes, signal.SIGCONT)
            return begun
        timer = threading.Timer(action.lasts_s, run.signal, (action.processes, signal.SIGCONT))
        timer.start()
        if action.times > 1:
            timer.join()
            time.sleep(0.004)
    return None


def children(parent: int) -> dict[str, int]:
    """The processes of a run that are there, by name."""
    found: dict[str, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            ppid = int(stat.read_text().rsplit(")", 1)[1].split()[1])
            arguments = (stat.parent / "cmdline").read_bytes()
        except (OSError, IndexError):
            continue
        if ppid == parent:
            found |= {name: int(stat.parent.name) for name, module in MODULES.items() if module.encode() in arguments}
    return found


def _limited(text: str, limits: dict[str, float]) -> str:
    for name, value in limits.items():
        text = re.sub(rf"^  {name}: .*\n", "", text, flags=re.MULTILINE)
        text = text.replace("\nlimits:\n", f"\nlimits:\n  {name}: {value:g}\n")
    return text


def lives(pid: int) -> bool:
    """True while a process is there and not stopped."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state not in ("Z", "T")
