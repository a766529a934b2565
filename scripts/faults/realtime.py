"""One trial in real time: a `rig run` with a fault at a given moment."""

from __future__ import annotations

import contextlib
import random
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path

from rig.simulator.registers import Registers
from scripts.faults.environment import UnsupportedFaultError
from scripts.faults.fault import Fault, FaultTrial
from scripts.faults.fault_trial import EndedBeforeError, TrialObservation, judge, skipped
from scripts.faults.trial_run import END_S, TrialRun


class OutputMonitor(threading.Thread):
    """Watches the outputs of a run from now on."""

    def __init__(self, run: TrialRun, registers: Registers) -> None:
        super().__init__(daemon=True)
        self._run, self._registers = run, registers
        self._safe_ns: int | None = None
        self.start()

    def run(self) -> None:
        """Monitor until the run ends."""
        self._safe_ns = self._run.watch(self._registers)

    def result(self) -> int | None:
        """Since when the outputs have been safe [ns], once the run has ended."""
        self.join()
        return self._safe_ns


def trial(fault: Fault, folder: Path, at_s: float, seed: int) -> FaultTrial:
    """Run one trial in real time."""
    if made := fault.injection.trial(fault, folder, at_s, seed):
        return made
    fault = fault.injection.decided(fault, random.Random(seed))
    out = folder / "out"
    out.mkdir()
    try:
        with ExitStack() as stack:
            injection = fault.injection.prepared(folder, stack)
            run = TrialRun(
                folder,
                environment=injection.environment,
                bench=fault.bench,
                protocol=fault.bench.protocol.format(moving_s=fault.moving_s),
                edit=injection.edit_rig,
                terminal=injection.terminal,
            )
            with closing(run):
                registers = run.wait_until_moving()
                time.sleep(at_s)
                if run.ended(registers):
                    run.process.wait(END_S)
                    raise EndedBeforeError(run.output[-1500:])
                watch = OutputMonitor(run, registers)
                fault_ns = time.monotonic_ns()
                fault_ns = injection.inject_realtime(run) or fault_ns
                safe_ns = watch.result()
                run.undo.close()
                time.sleep(0.1)
                output = run.output
            with contextlib.suppress(FileNotFoundError):
                (out / "filler").unlink()
            return judge(fault, "real", at_s, TrialObservation(fault_ns, safe_ns, output), out)
    except UnsupportedFaultError as why:
        return skipped(fault, "real", at_s, str(why))
