"""A `rig run` in a process of its own, on a mock card of its own, for tests and benchmarks to watch, stop and kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from rig.config import loader
from rig.realtime.timing_limits import STRICT_HUNG_S
from rig.simulator.registers import Registers, path_of

SHORT = """
title: A short climb
steps:
  - ramp: {actuators: [1, 2, 3], to_bar: 0.3, duration_s: 1}
  - hold: {duration_s: 20}
"""
BRIEF = """
title: A brief climb
steps:
  - ramp: {actuators: [1], to_bar: 0.2, duration_s: 0.6}
  - hold: {duration_s: 0.4}
"""
PATIENCE_S = 60.0
HUNG_S = 0.2
"""When control counts as hung in a test that is not about this time: longer than the stalls of a shared machine."""


def write_rig(folder: Path, *, one_opener: bool = False, like: str = "mock", supervised: bool = True) -> Path:
    """Write a copy of a mock rig with a card of its own, which may admit one process only.

    `supervised`: with the limits of a real bench, and `HUNG_S`.
    """
    device = f"test-{os.getpid()}-{abs(hash(str(folder))) % 10**8}"
    text = with_one_opener(loader.text(like).replace("device: mock0", f"device: {device}"), one_opener=one_opener)
    path = folder / "rig.yaml"
    path.write_text(strict(text, HUNG_S) if supervised else text)
    return path


def strict(text: str, hung_s: float = STRICT_HUNG_S) -> str:
    """The text of a rig with the strict timing limits of a real bench: it states `hung_s`."""
    assert text.count("\nlimits:\n") == 1
    return text.replace("\nlimits:\n", f"\nlimits:\n  hung_s: {hung_s:g}\n")


def with_one_opener(text: str, *, one_opener: bool) -> str:
    """The mock rig whose card allows one process at a time, or any number."""
    assert text.count("{driver: mock, ") == 1
    return text.replace("{driver: mock, ", f"{{driver: mock, one_opener: {str(one_opener).lower()}, ")


def children(pid: int) -> dict[str, int]:
    """The children of a process that execute a module, by its name."""
    found: dict[str, int] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rsplit(")", 1)[1].split()[1])
            arguments = (stat.parent / "cmdline").read_text().split("\0")
        except (OSError, IndexError):
            continue
        if parent == pid and "-m" in arguments[:-1]:
            found[arguments[arguments.index("-m") + 1]] = int(stat.parent.name)
    return found


def child_of(pid: int, module: str) -> int:
    """The child of a process that executes a module."""
    found = children(pid)
    assert module in found, f"no process runs {module}"
    return found[module]


class RigProcess:
    """One `rig run` under test."""

    def __init__(
        self,
        folder: Path,
        protocol: str,
        *options: str,
        one_opener: bool = False,
        like: str = "mock",
        supervised: bool = True,
    ) -> None:
        self.folder = folder
        self.out = folder / "out"
        self.rig_file = write_rig(folder, one_opener=one_opener, like=like, supervised=supervised)
        self.config = loader.load(self.rig_file)
        (folder / "protocol.yaml").write_text(protocol)
        self._log = (folder / "log").open("w+")
        self._cards: list[Registers] = []
        command = [sys.executable, "-m", "rig", "run", str(folder / "protocol.yaml"), "--rig", str(self.rig_file)]
        self.process = subprocess.Popen(
            [*command, "--out", str(self.out), "--yes", "--no-report", *options],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    @property
    def devices(self) -> list[str]:
        """The names of the run's own mock cards."""
        return [f"{card.device}-{self.process.pid}" for card in self.config.cards.values()]

    @property
    def output(self) -> str:
        """Everything printed so far."""
        return (self.folder / "log").read_text()

    def look(self) -> bool:
        """Map the cards once the run has made them, and keep the maps: the run removes its cards. True if mapped."""
        if not self._cards and all(path_of(device).exists() for device in self.devices):
            self._cards = [Registers.attach(device) for device in self.devices]
        return bool(self._cards)

    @property
    def cards(self) -> list[Registers]:
        """The run's cards, also after the run."""
        assert self.look(), f"the run has made no card:\n{self.output}"
        return self._cards

    @property
    def card(self) -> Registers:
        """The run's first card, also after the run."""
        return self.cards[0]

    def valve_v(self) -> np.ndarray:  # type: ignore[type-arg]
        """Voltages of the card's outputs, read from outside the run."""
        return self.card.outputs["value"].copy()

    def valves_are_safe(self) -> bool:
        """Whether every output has the venting voltage."""
        return bool(np.all(self.valve_v() < 0.01))

    def wait_until_started(self) -> None:
        """Wait until the run has checked its input and starts its processes."""
        deadline = time.monotonic() + PATIENCE_S
        while not self.look():
            assert self.process.poll() is None, self.output
            assert time.monotonic() < deadline, self.output
            time.sleep(0.005)

    def wait_until_pressurised(self) -> None:
        """Wait until the run drives the valves."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            assert self.process.poll() is None, self.output
            if self.look() and bool(np.any(self.valve_v() > 4.0)):
                time.sleep(0.3)
                return
            time.sleep(0.02)
        raise AssertionError(f"the run never drove a valve:\n{self.output}")

    def wait_until_safe(self, seconds: float = 5.0) -> None:
        """Wait until the valves are safe and stay safe."""
        deadline = time.monotonic() + seconds
        while not self.valves_are_safe():
            assert time.monotonic() < deadline, f"valves at {self.valve_v()} V:\n{self.output}"
            time.sleep(0.001)
        time.sleep(0.2)
        assert self.valves_are_safe()

    def pid_of(self, module: str) -> int:
        """The process of the run that executes a module."""
        found = children(self.process.pid)
        assert module in found, f"no process runs {module}:\n{self.output}"
        return found[module]

    def end(self) -> int:
        """Wait for the run to end by itself; its exit status."""
        deadline = time.monotonic() + PATIENCE_S
        while not self.look() and self.process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
        return self.process.wait(max(0.1, deadline - time.monotonic()))

    def close(self) -> None:
        """Close the log."""
        self._log.close()

    def archive(self) -> Path:
        """The one archive that the run left."""
        (found,) = self.out.glob("*.h5")
        return found


@contextmanager
def rig_run(
    folder: Path,
    protocol: str = SHORT,
    *options: str,
    one_opener: bool = False,
    like: str = "mock",
    supervised: bool = True,
) -> Iterator[RigProcess]:
    """Start a run, and remove its processes and files at the end."""
    run = RigProcess(folder, protocol, *options, one_opener=one_opener, like=like, supervised=supervised)
    try:
        yield run
    finally:
        for module in (
            "rig.realtime.watchdog_process",
            "rig.realtime.control_process",
            "rig.realtime.observer_process",
            "rig.realtime.tip_controller_process",
        ):
            try:
                os.kill(run.pid_of(module), signal.SIGCONT)
            except (AssertionError, ProcessLookupError):
                continue
        run.process.kill()
        run.process.wait()
        run.close()
        for device in run.devices:
            Registers.remove(device)
