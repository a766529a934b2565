"""Starts and stops the plant process of a rig with mock devices."""

from __future__ import annotations

import itertools
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.config.bench import BenchConfig
from rig.config.drivers import Reality
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError
from rig.hardware.lock import holders
from rig.hardware.running import RunningRig, records
from rig.simulator.registers import Registers

READY = b"ready\n"
POLL_S = 0.005
EXIT_S = 2.0
LEFT_S = 3600.0
"""How long the simulated cards of a killed run are kept: nobody vents them or looks at them any more."""


class PlantProcess:
    """A running plant process, for the supervisor."""

    def __init__(self, process: subprocess.Popen[bytes], config: RigConfig) -> None:
        self._process = process
        self._config = config
        self._output = b""
        self._registers: Registers | None = None

    def ready(self) -> bool:
        """True once its cards exist; does not wait. Raises CardError: the plant did not start."""
        assert self._process.stdout is not None
        if self._output == READY:
            return True
        if not select.select([self._process.stdout], [], [], 0)[0]:
            return False
        more = os.read(self._process.stdout.fileno(), len(READY))
        self._output += more
        if not more:
            self._wait()
            raise CardError(f"the simulator did not start (exit status {self._process.returncode})")
        if not READY.startswith(self._output):
            raise CardError(f"the simulator did not start: its output is {self._output!r}")
        if self._output != READY:
            return False
        mocks = [card.device for card in self._config.cards.values() if card.reality is Reality.SIMULATED]
        self._registers = Registers.attach(mocks[0]) if mocks else None
        return True

    def late_ns(self, now_ns: int) -> int:
        """Delay [ns] of the plant behind a time of CLOCK_MONOTONIC."""
        return 0 if self._registers is None else now_ns - self._registers.plant_t_ns

    def set_tip_weight(self, weight_kg: float) -> None:
        """Put a weight on the end cap, as a prompt requests from the operator."""
        if self._registers is not None:
            self._registers.set_tip_weight(weight_kg)

    @property
    def exit_status(self) -> int | None:
        """The plant's exit status once it has died, None while it lives."""
        return self._process.poll()

    def close(self) -> None:
        """Kill the process, also a stopped one; it needs no clean-up."""
        if self._registers is not None:
            self._registers.close()
        self._process.kill()
        self._wait()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def _wait(self) -> None:
        # A time-out, because the exit of a traced process is hidden until its debugger collects it.
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(EXIT_S)


@contextmanager
def started(config: RigConfig, rig_file: Path, seed: int, waits_ns: int | None = None) -> Iterator[PlantProcess | None]:
    """Run the plant of the rig's mock devices within the context; None for a rig without mock devices.

    Its cards exist once it is `ready`. With `waits_ns` its time stops while open valves are not written for longer.
    """
    if all(device.reality is not Reality.SIMULATED for device in config.devices):
        yield None
        return
    command = [sys.executable, "-P", "-m", "rig.simulator.plant_process", "--rig", str(rig_file), "--seed", str(seed)]
    for name, card in config.cards.items():
        if card.reality is Reality.SIMULATED:
            command += ["--device", name, card.device]
    if waits_ns is not None:
        command += ["--waits-ms", f"{waits_ns * 1e-6:g}"]
    process = subprocess.Popen(
        [*command, "--parent", str(os.getpid())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        bufsize=0,
        start_new_session=True,
    )
    simulation = PlantProcess(process, config)
    try:
        yield simulation
    finally:
        simulation.close()


@contextmanager
def simulated(
    config: RigConfig, rig_file: Path, seed: int, waits_ns: int | None = None
) -> Iterator[PlantProcess | None]:
    """As `started`, but ready; its cards are removed at the end. Raises CardError: the plant did not start."""
    try:
        with started(config, rig_file, seed, waits_ns) as simulation:
            while simulation is not None and not simulation.ready():
                time.sleep(POLL_S)
            yield simulation
    finally:
        for card in config.cards.values():
            if card.reality is Reality.SIMULATED:
                Registers.remove(card.device)


def is_absent(config: BenchConfig) -> bool:
    """Return True for a rig of simulated cards that do not exist: no simulator runs behind one, and no run has any."""
    absent = (card.reality is Reality.SIMULATED and not Registers.exist(card.device) for card in config.cards.values())
    return all(absent) and not holders(config)


_own: set[str] = set()
"""Names of the simulated benches of this process."""


@contextmanager
def own_devices(config: RigConfig) -> Iterator[RigConfig]:
    """The rig with simulated cards that only this run has, so that any number of runs of it go on at once.

    A card's name gets the process id, and a number if this process has several benches. The cards are removed at the
    end; those of killed runs LEFT_S after their start.
    """
    if all(device.reality is not Reality.SIMULATED for device in config.devices):
        yield config
        return
    names = (f"{os.getpid()}-{number}".removesuffix("-1") for number in itertools.count(1))
    name = next(name for name in names if name not in _own)
    _own.add(name)
    _remove_leftovers()
    cards = {
        key: card.model_copy(update={"device": f"{card.device}-{name}"}) if card.reality is Reality.SIMULATED else card
        for key, card in config.cards.items()
    }
    try:
        yield config.model_copy(update={"cards": cards})
    finally:
        _own.discard(name)
        for card in cards.values():
            if card.reality is Reality.SIMULATED:
                Registers.remove(card.device)


def remove_cards(run: RunningRig) -> None:
    """Remove the simulated cards of a run that was killed."""
    for card in run.bench["cards"].values():
        if card["driver"] == "mock":
            Registers.remove(card["device"])


def _remove_leftovers() -> None:
    """Remove the records and cards of simulated runs that were started long ago and killed."""
    for run in records()[0]:
        with suppress(OSError, KeyError, TypeError, AttributeError):
            age_s = time.clock_gettime(time.CLOCK_BOOTTIME) - run.process.start / os.sysconf("SC_CLK_TCK")
            if run.simulated and not run.alive and age_s > LEFT_S:
                remove_cards(run)
                run.file.unlink()
