"""Starts the plant process of a rig with mock devices, and stops it again."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rig.config import RigConfig
from rig.daq.base import CardError
from rig.simulator.registers import Registers


class Simulation:
    """A running plant, as the conductor sees it."""

    def __init__(self, process: subprocess.Popen[str], registers: Registers | None) -> None:
        self._process = process
        self._registers = registers

    def hang(self, weight_kg: float) -> None:
        """Do what a prompt asks of the operator: hang a weight on the end cap."""
        if self._registers is not None:
            self._registers.hang(weight_kg)

    @property
    def exit_status(self) -> int | None:
        """The plant's exit status once it has died, None while it lives."""
        return self._process.poll()


@contextmanager
def simulated(config: RigConfig, rig_file: Path, seed: int) -> Iterator[Simulation | None]:
    """Keep the plant running behind the rig's mock devices; None for a rig that has none.

    Raises:
        CardError: the plant did not start.
    """
    if not config.simulated:
        yield None
        return
    command = [sys.executable, "-m", "rig.simulator.process", "--rig", str(rig_file), "--seed", str(seed)]
    process = subprocess.Popen(
        [*command, "--parent", str(os.getpid())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    registers = None
    try:
        if process.stdout.readline().strip() != "ready":
            raise CardError(f"the simulator did not start (exit status {process.wait()})")
        mocks = [card.device for card in config.cards.values() if card.driver == "mock"]
        registers = Registers.attach(mocks[0]) if mocks else None
        yield Simulation(process, registers)
    finally:
        if registers is not None:
            registers.close()
        process.terminate()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
