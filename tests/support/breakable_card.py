"""The example driver with one fault, which the rig file names: the conformance tests must find each."""

from __future__ import annotations

import ctypes
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from softrig_pneubox import BAR_PER_V, Pneubox, PneuboxConfig, file_of  # type: ignore[import-not-found]

from rig.config.drivers import Driver
from rig.hardware.cards.base import CardBusyError, CardError, CardSetup, Scans

BEHIND_S = 0.03
LATE_NS = 150_000_000
FLOOD = 2_000_000
DRIVEN_S = 1.0


def stuck(fault: str) -> None:
    """Do not return, or end the process, as a driver may by mistake."""
    if fault == "hangs":
        time.sleep(3600)
    elif fault == "holds the interpreter":
        ctypes.PyDLL(None).sleep(3600)
    elif fault == "loops":
        while True:
            pass
    elif fault == "prints without end":
        while True:
            print("read " * 1000)
    elif fault == "fills the memory":
        kept = []
        while True:
            kept.append(np.empty(1 << 27))
    elif fault == "crashes":
        ctypes.string_at(0)
    elif fault == "exits":
        raise SystemExit(0)
    elif fault == "exits at once":
        os._exit(0)
    elif fault == "aborts":
        os.abort()
    elif fault == "stops itself":
        os.kill(os.getpid(), signal.SIGSTOP)
    elif fault == "kills its session":
        os.killpg(0, signal.SIGKILL)


class BreakableConfig(PneuboxConfig):  # type: ignore[misc]
    """The example's keys, and the fault."""

    fault: str


class Breakable(Pneubox):  # type: ignore[misc]
    """The example's card with a fault; one of `stuck` reads `hangs in write`, or `hangs in any opening`."""

    def __init__(self, setup: CardSetup) -> None:
        """Open the box."""
        self._fault = setup.section.fault
        self._setup = setup
        self._stuck("any opening")
        if setup.inputs:
            self._stuck("opening")
        self._reads, self._echo, self._began_s = 0, None, None
        self._closed, self._late = False, []
        owner = Path(f"{file_of(setup.device)}.owner")
        watched = not setup.inputs
        if self._fault == "stale lock" and owner.exists():
            raise CardError("the box is in use")
        if watched and self._fault == "refuses the watchdog":
            raise CardError("no second process, please")
        if watched and self._fault == "does not name the holder" and owner.exists():
            raise CardBusyError("the box", ())
        if watched and self._fault == "raises an OSError" and owner.exists():
            raise OSError("device busy")
        super().__init__(setup)
        self._owner = owner if setup.inputs else None
        if self._owner:
            self._owner.write_text(str(os.getpid()))
        if watched and self._fault == "the second opener disconnects the first":
            owner.write_text("disconnected")
        if self._fault == "opening drives":
            super().write(np.full(len(setup.outputs), 3.3))
        if self._fault == "opening writes zero":
            super().write(np.zeros(len(setup.outputs)))

    @property
    def _wrote_s(self) -> float:
        """Time since the first output that moved."""
        return 0.0 if self._began_s is None else time.monotonic() - self._began_s

    def _stuck(self, where: str) -> None:
        if self._fault.endswith(f" in {where}"):
            stuck(self._fault.removesuffix(f" in {where}"))

    def start(self) -> None:
        """Sample from now on."""
        self._stuck("start")
        super().start()
        if self._fault == "start writes zero":
            super().write(np.zeros(len(self._outputs)))

    def read(self) -> Scans:
        """Scans, or what is wrong with them."""
        self._stuck("read")
        if self._fault == "slow read":
            time.sleep(BEHIND_S)
        if self._fault == "read never returns" and not file_of(self._setup.device).exists():
            time.sleep(3600)
        if self._owner and self._owner.exists() and self._owner.read_text() == "disconnected":
            raise CardError("connection lost")
        if self._fault == "blind to a pulled cable":
            return Scans(np.array([time.monotonic_ns()]), np.ones((1, len(self._inputs))))
        if self._fault == "now and then a slow read":
            self._reads += 1
            time.sleep(BEHIND_S if self._reads % 15 == 0 else 0.0)
        scans: Scans = super().read()
        if self._fault == "returns scans without end":
            times = time.monotonic_ns() - np.arange(FLOOD, 0, -1)
            return Scans(times, np.zeros((FLOOD, len(self._inputs))))
        if self._fault == "millivolts":
            return replace(scans, signals=scans.signals * 1000)
        if self._fault == "late scans":
            self._late.append(scans)
            due = len(self._late[0].t_ns) and time.monotonic_ns() - self._late[0].t_ns[0] > LATE_NS
            return self._late.pop(0) if due else Scans.none(len(self._inputs))
        if self._fault == "swaps inputs":
            return replace(scans, signals=scans.signals[:, ::-1])
        if self._fault.startswith("a sensor is stuck"):
            scans.signals[:, 1] = 0.0 if self._fault.endswith("zero") else 0.6
        if self._fault == "delivers twice":
            return Scans(np.repeat(scans.t_ns, 2), np.repeat(scans.signals, 2, axis=0))
        if self._fault == "wall clock" or (self._fault == "wall clock later" and self._wrote_s > DRIVEN_S):
            return replace(scans, t_ns=np.array([time.time_ns()]))
        if self._fault == "repeated time":
            return replace(scans, t_ns=scans.t_ns // 10**9 * 10**9)
        if self._fault == "one column":
            return replace(scans, signals=scans.signals[:, :1])
        if self._fault == "no scans":
            return Scans(scans.t_ns[:0], scans.signals[:0])
        if self._fault == "not a number":
            return replace(scans, signals=scans.signals * np.nan)
        return scans

    def write(self, outputs: Any) -> None:
        """Set the outputs, or not."""
        self._stuck("write")
        if self._fault == "slow write":
            time.sleep(BEHIND_S)
        if self._fault == "takes NaN" and np.any(np.isnan(outputs)):
            return
        if self._fault == "writes nothing and reads back the last write":
            self._echo = np.array(outputs)
            return
        if self._fault.endswith("for a device in bar"):
            self._echo = np.array(outputs)
            super().write(np.array(outputs) / BAR_PER_V)
            return
        if self._fault in {"swaps outputs", "writes and reads back in the wrong order"}:
            outputs = outputs[::-1]
        if self._fault == "offset":
            outputs = np.add(outputs, 0.2)
        if self._fault == "drops the last output":
            outputs = np.append(outputs[:-1], 0.0)
        if self._fault == "does not clip":
            super().write(outputs)
            self._volts[self._outputs] = outputs
            return
        if self._fault == "second write is lost" and self._owner is None:
            return
        if self._fault == "blind to a pulled cable" and not file_of(self._setup.device).exists():
            return
        super().write(outputs)
        self._echo = np.array(outputs)
        if self._began_s is None and np.any(outputs):
            self._began_s = time.monotonic()

    def readback(self) -> Any:
        """The outputs, or what the driver takes for them."""
        echoes = ("echoes its own write", "writes nothing and reads back the last write")
        if (self._fault in echoes or self._fault.endswith("for a device in bar")) and self._echo is not None:
            return self._echo
        if self._fault == "writes and reads back in the wrong order":
            return super().readback()[::-1]
        if self._fault == "frozen read-back":
            return np.full(len(self._outputs), 5.0)
        return super().readback()

    def _write_on(self, volts: Any) -> None:
        while True:
            memory = np.memmap(file_of(self._setup.device), np.float64, "r+")
            memory[: len(volts)] = volts
            time.sleep(0.001)

    def _step(self) -> int:
        if self._fault == "does not vent":
            self._times[1] = time.monotonic_ns()
        now: int = super()._step()
        return now

    def close(self) -> None:
        """Release the box."""
        self._stuck("close")
        if self._fault == "closing writes zero" and not self._closed:
            super().write(np.zeros(len(self._outputs)))
        if self._fault == "a thread writes on" and not self._closed:
            threading.Thread(target=self._write_on, args=(np.array(self._volts),)).start()
        if self._owner:
            self._owner.unlink(missing_ok=True)
        if self._fault == "the second close raises" and self._closed:
            raise ValueError("already closed")
        if self._fault == "closing raises":
            raise OSError("cable pulled")
        self._closed = True
        super().close()


breakable = Driver(
    BreakableConfig,
    Breakable,
    about="a box with a fault",
    simulated=True,
    silence_s=lambda section: section.silence_ms * 1e-3,
)
