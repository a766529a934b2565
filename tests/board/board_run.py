"""A run on the emulated board: its rig and protocol, and the times of a fault and of the safe state by the board."""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import signal
from contextlib import suppress
from pathlib import Path

import numpy as np

import runs
from rig.config.loader import load
from rig.hardware.cards.comedi_device import Device
from rig.hardware.safe_state import SafeOutputs
from runs.run import Run
from tests.board.conftest import CARD
from tests.board.monitor import Monitor
from tests.hardware import forked_run
from tests.hardware.forked_run import members, wait_until

OUT_V = 0.01
FIRST_SENSOR = "ai0"
LONG_S, SHORT_S = 600.0, 120.0
SECTIONS_OF_A_CAMERA = re.compile(r"^(cameras|board):.*?(?=^\S|\Z)", re.MULTILINE | re.DOTALL)
RAMP = """
title: A pressure that is held for longer than any fault
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}
  - hold: {duration_s: 119}
"""
VENTED_V, RISEN_V = 0.05, 0.2
"""At 0 bar the valve may stand at its safe voltage for a moment: a fault waits for pressure, at 1 V for 1 bar."""


def rig_text(name: str) -> str:
    """The file of a rig that softrig brings; one with a Comedi card is on the emulated board."""
    stated = (Path(forked_run.__file__).parents[2] / f"rig/rigs/{name}.yaml").read_text()
    return stated.replace("driver: comedi,", "driver: comedi, emulated: true,")


def emulated_rig(folder: Path) -> str:
    """The rig `pci1716` without its camera, on the emulated board, as a file in `folder`."""
    path = folder / "emulated.yaml"
    path.write_text(SECTIONS_OF_A_CAMERA.sub("", rig_text("pci1716")))
    return str(path)


class DigitalMark:
    """A change of the board's digital outputs, whose time the board keeps, beside that of its D/A outputs."""

    _INSN = (2 << 30) | (40 << 16) | (ord("d") << 8) | 12
    """COMEDI_INSN: _IOR('d', 12, struct comedi_insn)."""
    _BITS = 0xC000002
    """INSN_BITS."""

    class _Instruction(ctypes.Structure):
        _fields_ = (
            ("insn", ctypes.c_uint),
            ("n", ctypes.c_uint),
            ("data", ctypes.POINTER(ctypes.c_uint)),
            ("subdevice", ctypes.c_uint),
            ("chanspec", ctypes.c_uint),
            ("unused", ctypes.c_uint * 3),
        )

    def __init__(self) -> None:
        device = Device(CARD)
        self._subdevice = [kind for kind, _ in device.subdevices].index("do")
        device.close()
        self._node = os.open(CARD, os.O_RDWR)

    def set(self) -> None:
        """Mark the present moment."""
        data = (ctypes.c_uint * 2)(1, 1)
        fcntl.ioctl(self._node, self._INSN, self._Instruction(self._BITS, 2, data, self._subdevice))

    def close(self) -> None:
        os.close(self._node)


class BoardRun:
    """A run that drives a valve of the emulated board."""

    def __init__(self, folder: Path, monitor: Monitor) -> None:
        folder.mkdir(exist_ok=True)
        self.rig_file = emulated_rig(folder)
        protocol = folder / "ramp.yaml"
        protocol.write_text(RAMP)
        self.safe_output = SafeOutputs.of(load(self.rig_file).valves).held.tolist()
        self._monitor, self._out = monitor, folder / "runs"
        monitor.set("reset", value=True)  # another test may have left the outputs at any voltage
        wait_until(lambda: monitor.get(FIRST_SENSOR) < VENTED_V, SHORT_S, "the chamber is vented")
        self.process = forked_run.run(self.rig_file, str(protocol), self._out)
        try:
            self._await_pressure()
            assert self.process.poll() is None, self.said()
        except BaseException:
            self.end()
            raise
        self.members = members(self.process.pid)

    def _await_pressure(self) -> None:
        """Return when the chamber is under pressure, or the run has ended."""
        wait_until(
            lambda: self.process.poll() is not None or self._monitor.get(FIRST_SENSOR) > RISEN_V,
            LONG_S,
            "the chamber is under pressure",
        )

    def safe(self) -> bool:
        """True where each D/A output has its safe voltage."""
        return bool(np.allclose(self._monitor.outputs_v, self.safe_output, atol=OUT_V))

    def safe_after_ms(self, patience_s: float = SHORT_S) -> float:
        """Time from the digital mark to the last change of a D/A output, once these are safe."""
        wait_until(self.safe, patience_s, "the D/A outputs are safe")
        return float(self._monitor.get("outputs-changed-ns") - self._monitor.get("digital-written-ns")) * 1e-6

    def said(self) -> str:
        """Everything that was printed, once the run is over."""
        said = self.process.communicate(timeout=LONG_S)[0].decode(errors="replace")
        print(said)
        return said

    def archive(self) -> Run:
        """The archive that is left."""
        (path,) = self._out.glob("*.h5")
        return runs.open(path)

    def end(self) -> None:
        """No process of the run is left."""
        for pid in members(self.process.pid).values():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
