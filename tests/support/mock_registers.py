"""Registers of a mock card without a plant."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rig.simulator.registers import Registers


@contextmanager
def mock_registers(device: str, volts: float = 0.0) -> Iterator[Registers]:
    """The registers of a mock card with two outputs at some volts and eight inputs; removed at the end."""
    registers = Registers.create(device, 2, 8)
    registers.outputs["value"] = volts
    path = registers.path
    try:
        yield registers
    finally:
        registers.close()
        path.unlink()
