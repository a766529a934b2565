"""A run on the kernel's devices that is struck: what its valves do, what it says, what is left of its record.

The valves' voltages are what another process reads back through the card's inputs, by its own handle.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import runs
from runs.recovery import RecoveryStatus, recover
from runs.run import Run
from tests.hardware import forked_run
from tests.hardware.forked_run import members, wait_until
from tests.hardware.kernel_card import COUNT_V
from tests.hardware.rig_of_the_machine import LOOPED, SLOW_RAMP

MOVING_V = 0.5
LONG_S, SHORT_S = 600.0, 240.0

Inputs = Callable[[], NDArray[np.float64]]
"""Reads the inputs of the valves [V]."""


class Struck:
    """A run that has moved a valve, and the valves as they are seen from outside it."""

    def __init__(self, out: Path, inputs: Inputs) -> None:
        self.out = out
        self.inputs = inputs
        self.process = forked_run.run(LOOPED, SLOW_RAMP, out)
        try:
            wait_until(lambda: self.over() or bool(inputs().max() > MOVING_V), LONG_S, "a valve moves")
            assert not self.over(), self.said()
        except BaseException:
            self.end()
            raise
        self.members = members(self.process.pid)

    def over(self) -> bool:
        return self.process.poll() is not None

    def strike(self, number: signal.Signals, *names: str) -> int:
        """Send members a signal, all at once; when [ns]."""
        struck_ns = time.monotonic_ns()
        if len(names) > 1:
            # On a slow machine the second may end, because the first is dead, before it gets its signal.
            for name in names:
                os.kill(self.members[name], signal.SIGSTOP)
        for name in names:
            os.kill(self.members[name], number)
        return struck_ns

    def until_safe_ms(self, struck_ns: int) -> float:
        """How long it took until every valve was seen at its safe voltage."""
        wait_until(lambda: bool(np.abs(self.inputs()).max() < 2 * COUNT_V), SHORT_S, "the valves are safe")
        return (time.monotonic_ns() - struck_ns) * 1e-6

    def said(self) -> str:
        """Everything that was printed, once the run is over; printed again, to be seen where a test fails."""
        said = self.process.communicate(timeout=SHORT_S)[0].decode(errors="replace")
        print(said)
        self.wait_for_the_others()
        return said

    def wait_for_the_others(self) -> None:
        """No process of the run is left."""
        wait_until(lambda: not any(map(_runs, self.members.values())), SHORT_S, "the others end")

    def archive(self) -> Run:
        """The one archive that is left."""
        (path,) = self.out.glob("*.h5")
        return runs.open(path)

    def recovered(self) -> Run:
        """What is made of the journal that a killed supervisor left, when no process of the run is left."""
        self.wait_for_the_others()
        (outcome,) = recover(self.out)
        assert outcome.status is RecoveryStatus.RECOVERED, outcome.message
        return self.archive()

    def end(self) -> None:
        for pid in members(self.process.pid).values():
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
