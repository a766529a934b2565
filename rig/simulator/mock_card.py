"""The mock card: reads and writes the shared file of the plant, from any process."""

from __future__ import annotations

import fcntl
import os
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.hardware.cards.base import CardBusyError, CardError, CardSetup, Scans
from rig.hardware.runtime_folder import open_private
from rig.simulator.registers import DIGITAL_OUTPUTS, Registers, path_of, quantised_output


class MockCard:
    """A card whose sampling clock, inputs and valves live in the process `rig.simulator.plant_process`.

    Writing and read-back access registers, so they also work while the plant has stalled or is dead.
    """

    def __init__(self, setup: CardSetup) -> None:
        """Attach to the mock device. Raises CardError: it does not exist or lacks a channel."""
        self._device = setup.device
        self._exclusive_lock = _lock_exclusively(setup.device) if setup.section.one_opener else -1
        try:
            self._registers = Registers.attach(setup.device)
        except CardError:
            self._unlock()
            raise
        self._inputs = [channel.number for channel in setup.inputs]
        self._outputs = setup.outputs
        self._digital_inputs = setup.digital_inputs
        self._digital_outputs = setup.digital_outputs
        counts = self._registers.header
        for what, channels, has in (
            ("input", setup.inputs, int(counts["inputs"][0])),
            ("output", setup.outputs, int(counts["outputs"][0])),
        ):
            missing = [c.number for c in channels if c.number >= has]
            if missing:
                self.close()
                raise CardError(f"mock card {setup.device} has {has} {what}s: there is no {what} {missing[0]}")
        if missing := [number for number in setup.digital_outputs if number >= DIGITAL_OUTPUTS]:
            self.close()
            raise CardError(
                f"mock card {setup.device} has {DIGITAL_OUTPUTS} digital outputs: there is no output {missing[0]}"
            )
        self._next: int | None = None

    def start(self) -> None:
        """Take scans from now on; the plant samples all the time."""
        self._next = self._registers.scans_written

    def read(self) -> Scans:
        """Scans since the last call; none before `start`."""
        if self._next is None:
            return Scans.none(len(self._inputs))
        self._registers.faults.before_read(self._device, waits=True)
        # Read before the scans: data published in between can only increase the delay.
        late_ns = max(0, time.monotonic_ns() - self._registers.plant_t_ns)
        scans, self._next = self._registers.scans_since(self._next, self._inputs)
        return replace(self._registers.faults.of_scans(scans), late_ns=late_ns)

    def read_digital(self) -> NDArray[np.bool_]:
        """Whether each digital input is high: it is, unless its contact is open."""
        return self._registers.faults.contacts_closed(self._digital_inputs)

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the outputs with a resolution of 16 bits."""
        self._registers.faults.before_write(self._device)
        values = [quantised_output(v, c.low, c.high) for v, c in zip(outputs.tolist(), self._outputs, strict=True)]
        now = time.monotonic_ns()
        for channel, value in zip(self._outputs, values, strict=True):
            self._registers.write(channel.number, value, now)

    def write_digital(self, *, high: bool) -> None:
        self._registers.faults.before_write(self._device)
        now = time.monotonic_ns()
        for number in self._digital_outputs:
            self._registers.write_digital(number, now, high=high)

    def readback(self) -> NDArray[np.float64]:
        outputs: NDArray[np.float64] = self._registers.outputs["value"][[c.number for c in self._outputs]]
        return outputs

    def close(self) -> None:
        self._registers.close()
        self._unlock()

    def _unlock(self) -> None:
        if self._exclusive_lock >= 0:
            os.close(self._exclusive_lock)
            self._exclusive_lock = -1


def _lock_exclusively(device: str) -> int:
    """Lock a device for this process until the descriptor is closed, by the kernel if the process dies."""
    lock = path_of(device).with_suffix(".open")
    try:
        descriptor = open_private(lock, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise CardError(f"mock card {device}: {lock}: {error.strerror or error}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(descriptor, 20, 0).decode(errors="replace")
        os.close(descriptor)
        raise CardBusyError(f"mock card {device}", (int(holder),) if holder.isdecimal() else ()) from None
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, str(os.getpid()).encode(), 0)
    return descriptor
