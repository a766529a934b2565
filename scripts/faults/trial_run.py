"""A run of the campaign: `rig run` in a process of its own, observed through its mock card's registers."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import rig.config.loader
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import SafeOutputs
from rig.simulator.faults import Faults
from rig.simulator.registers import Registers
from scripts.rig_process import children, strict

SUPERVISOR, CONTROL, WATCHDOG, OBSERVER, PLANT = "supervisor", "control", "watchdog", "observer", "plant"
TIP_CONTROLLER = "tip controller"
MODULES = {
    CONTROL: "rig.realtime.control_process",
    WATCHDOG: "rig.realtime.watchdog_process",
    OBSERVER: "rig.realtime.observer_process",
    PLANT: "rig.simulator.plant_process",
    TIP_CONTROLLER: "rig.realtime.tip_controller_process",
}
PROTOCOL = """
title: Both valves in motion
steps:
  - ramp: {{actuators: [1, 2, 3], to_bar: 0.3, duration_s: 0.6}}
  - sine: {{actuators: [1, 2, 3], mean_bar: 0.3, amplitude_bar: 0.2, omega_rad_s: 4, duration_s: {moving_s:g}}}
"""
TIP_PROTOCOL = """
title: The tip on a circle
steps:
  - tip:
      circle: {{centre_mm: [0, 0, 190], radius_mm: 15, period_s: {moving_s:g}, periods: 1}}
      lead_in_s: 1
"""
MOVING_S = 4.2
START_S, END_S = 200.0, 45.0
ENDED_S = 0.3
"""How long the registers are observed after the end of the run."""
MOVING_V = 4.0
STILL_S = 0.1
SEEN_SAFE_V = 0.01


@dataclass(frozen=True)
class TrialBench:
    """A simulated rig by name, and a protocol that keeps its valves moving for `moving_s`."""

    rig: str
    protocol: str


PRESSURES = TrialBench("mock", PROTOCOL)
TIP = TrialBench("mock-3", TIP_PROTOCOL)


def rig_text(device: str, bench: TrialBench = PRESSURES) -> str:
    """The rig of a bench with a card of its own."""
    return strict(rig.config.loader.text(bench.rig).replace("device: mock0", f"device: {device}"))


class TrialRun:
    """A `rig run` in a process of its own: its processes, its output, and the voltages of its valves."""

    def __init__(
        self,
        folder: Path,
        *,
        environment: Mapping[str, str] | None = None,
        bench: TrialBench = PRESSURES,
        protocol: str = PROTOCOL.format(moving_s=MOVING_S),
        limits: Mapping[str, float] | None = None,
        edit: Callable[[str], str] = str,
        terminal: bool = False,
    ) -> None:
        """Start it; `limits` replaces limits of the rig, `edit` changes its text; with `terminal` it runs on one."""
        self.out = folder / "out"
        self.rig_file, self.protocol = folder / "rig.yaml", folder / "protocol.yaml"
        device = f"faults-{os.getpid()}-{threading.get_native_id()}"
        self._card: Registers | None = None
        self.faults: Faults
        self.undo = ExitStack()
        """What ends a fault once the run has ended."""
        self.rig_file.write_text(_limited(edit(rig_text(device, bench)), limits or {}))
        self.protocol.write_text(protocol)
        self._safe_v = SafeOutputs.of(rig.config.loader.load(self.rig_file).valves).held
        self._chunks: list[bytes] = []
        self._listening = threading.Event()
        self._listening.set()
        command = [sys.executable, "-P", "-m", "rig", "run", str(self.protocol), "--rig", str(self.rig_file)]
        command += ["--out", str(self.out), "--yes", "--no-report"]
        self.screen, inner = os.openpty() if terminal else os.pipe()
        if terminal:
            fcntl.ioctl(inner, termios.TIOCSWINSZ, np.array([40, 100, 0, 0], np.uint16).tobytes())
        self.process = subprocess.Popen(
            command,
            stdin=inner if terminal else subprocess.DEVNULL,
            stdout=inner,
            stderr=inner,
            start_new_session=not terminal,
            preexec_fn=(lambda: os.login_tty(os.dup(inner))) if terminal else None,
            env={**os.environ, **(environment or {})},
        )
        self.device = f"{device}-{self.process.pid}"
        os.close(inner)
        threading.Thread(target=self._listen, daemon=True).start()
        self.members: dict[str, int] = {}

    @property
    def output(self) -> str:
        """Everything printed so far."""
        return b"".join(self._chunks).decode(errors="replace").replace("\r", "")

    def turn_away(self) -> None:
        """Stop reading what the run prints."""
        self._listening.clear()

    def turn_back(self) -> None:
        """Continue to read."""
        self._listening.set()

    def hang_up(self) -> None:
        """Close the terminal."""
        self._listening.clear()
        time.sleep(0.1)
        os.close(self.screen)
        self.screen = -1

    def _listen(self) -> None:
        while self.screen >= 0:
            self.attached()
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
            self._chunks.append(data)

    def wait_until_moving(self) -> Registers:
        """Return the card's registers once the run drives a valve, with every member of the run known."""
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline and self.process.poll() is None:
            registers = self.attached()
            if registers is not None and np.any(registers.outputs["value"] > MOVING_V):
                self.faults = registers.faults
                self.members = {SUPERVISOR: self.process.pid} | run_processes(self.process.pid)
                return registers
            time.sleep(0.02)
        raise RuntimeError(f"the run never drove a valve: {self.output}")

    def attached(self) -> Registers | None:
        """The card's registers, None as long as there are none; kept, because a run removes its card at its end."""
        if self._card is None:
            with contextlib.suppress(CardError):  # not there yet, or not yet complete
                self._card = Registers.attach(self.device)
        return self._card

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
        volts = registers.outputs["value"][: len(self._safe_v)]
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
        self.undo.close()
        self._listening.set()
        for pid in (*self.members.values(), self.process.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        if self.screen >= 0:
            screen, self.screen = self.screen, -1
            time.sleep(0.1)
            os.close(screen)
        if self._card is not None:
            self._card.close()
        Registers.remove(self.device)


def run_processes(parent: int) -> dict[str, int]:
    """The processes of a run that are there, by name."""
    found = children(parent)
    return {name: found[module] for name, module in MODULES.items() if module in found}


def _limited(text: str, limits: Mapping[str, float]) -> str:
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
