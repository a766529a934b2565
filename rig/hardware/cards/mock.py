"""The mock card, seen from any process: it reads and writes the shared file behind which the plant runs."""

from __future__ import annotations

import fcntl
import os
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.hardware.cards.base import CardBusyError, CardError, CardSetup, Scans
from rig.hardware.runtime_folder import open_private
from rig.simulator.converter import sixteen_bits
from rig.simulator.registers import Registers, path_of


def driver() -> type[MockCard]:
    """The driver `mock`."""
    return MockCard


class MockCard:
    """A card whose sampling clock, inputs and valves live in the process `rig.simulator.plant_process`.

    Writing and reading back work while the plant stands still or is dead: they are registers.
    """

    def __init__(self, setup: CardSetup) -> None:
        """Attach to the mock device.

        Raises:
            CardError: it does not exist or lacks a channel.
        """
        self._device = setup.device
        self._door = _only_opener(setup.device) if setup.one_opener else -1
        try:
            self._registers = Registers.attach(setup.device)
        except CardError:
            self._leave()
            raise
        self._inputs = [channel.number for channel in setup.inputs]
        self._outputs = setup.outputs
        counts = self._registers.header
        for what, channels, has in (
            ("input", setup.inputs, int(counts["inputs"][0])),
            ("output", setup.outputs, int(counts["outputs"][0])),
        ):
            missing = [c.number for c in channels if c.number >= has]
            if missing:
                self.close()
                raise CardError(f"mock card {setup.device} has {has} {what}s: there is no {what} {missing[0]}")
        self._next: int | None = None

    def start(self) -> None:
        """Take scans from now on; the plant samples all the time."""
        self._next = self._registers.scans_written

    def read(self) -> Scans:
        """Scans since the last call; none before `start`."""
        if self._next is None:
            return Scans(np.empty(0, np.int64), np.empty((0, len(self._inputs))))
        self._registers.faults.before_read(self._device, waits=True)
        # Before the scans: what the plant publishes in between only makes it look later than it is.
        late_ns = max(0, time.monotonic_ns() - self._registers.plant_t_ns)
        scans, self._next = self._registers.scans_since(self._next, self._inputs)
        return replace(self._registers.faults.of_scans(scans), late_ns=late_ns)

    def write(self, volts: NDArray[np.float64]) -> None:
        """Set the outputs, as near as 16 bits come."""
        self._registers.faults.before_write(self._device)
        values = [sixteen_bits(v, c.low_v, c.high_v) for v, c in zip(volts.tolist(), self._outputs, strict=True)]
        now = time.monotonic_ns()
        for channel, value in zip(self._outputs, values, strict=True):
            self._registers.write(channel.number, value, now)

    def readback(self) -> NDArray[np.float64]:
        """The voltages that the outputs stand at."""
        volts: NDArray[np.float64] = self._registers.outputs["volts"][[c.number for c in self._outputs]]
        return volts

    def close(self) -> None:
        """Let go of the device; the outputs keep their voltages."""
        self._registers.close()
        self._leave()

    def _leave(self) -> None:
        if self._door >= 0:
            os.close(self._door)
            self._door = -1


def _only_opener(device: str) -> int:
    """Be the only process in a device for as long as the descriptor is open; the kernel closes it for the dead."""
    door = path_of(device).with_suffix(".door")
    try:
        descriptor = open_private(door, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise CardError(f"mock card {device}: {door}: {error.strerror or error}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(descriptor, 20, 0).decode(errors="replace")
        os.close(descriptor)
        raise CardBusyError(f"mock card {device}", (int(holder),) if holder.isdecimal() else ()) from None
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, str(os.getpid()).encode(), 0)
    return descriptor
