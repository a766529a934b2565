"""One trial in virtual time: the plant that the executor makes for itself is given its fault at a moment."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

import numpy as np

from rig.config.schema import RigConfig
from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.hardware.safe_state import SafeOutputs
from rig.simulator.faults import Faults
from rig.simulator.plant import Plant
from rig.virtual.executor import START_NS
from runs.records import Event
from scripts.faults.environment import UnsupportedFaultError
from scripts.faults.fault import Fault, FaultTrial
from scripts.faults.fault_trial import TrialObservation, judge, skipped
from scripts.faults.trial_run import SEEN_SAFE_V, rig_text


class Listener(NullOperator):
    """An operator interface that stores messages."""

    def __init__(self) -> None:
        self.output: list[str] = []

    def report(self, event: Event) -> None:
        """Remember."""
        self.output.append(event.message)


class FaultyPlant(Plant):
    """A plant that injects a fault at `fault_ns`, and monitors its own outputs."""

    fault_ns = 0
    on_fault: ClassVar[Callable[[Faults], object]]
    made: ClassVar[FaultyPlant]

    def __init__(self, config: RigConfig, seed: int, t0_ns: int) -> None:
        super().__init__(config, seed, t0_ns)
        self._safe_v = SafeOutputs.of(config.valves).held
        self._due = True
        self.safe_ns: int | None = None
        type(self).made = self

    def advance(self, t_ns: int) -> None:
        """Let time pass, with the fault from its moment on."""
        if self._due and t_ns >= self.fault_ns:
            self._due = False
            super().advance(self.fault_ns)
            type(self).on_fault(self.faults)
        super().advance(t_ns)

    def set_output(self, valve: int, volts: float) -> None:
        """Remember since when every output has been safe."""
        super().set_output(valve, volts)
        outputs_v = np.array([self.output(i) for i in range(len(self._safe_v))])
        safe = bool(np.all(np.abs(outputs_v - self._safe_v) < SEEN_SAFE_V))
        self.safe_ns = (self.safe_ns if self.safe_ns is not None else self.t_ns) if safe else None


@dataclass(frozen=True)
class VirtualTarget:
    """The target of a fault in virtual time."""

    faults: Faults
    out: Path
    rig_file: Path
    protocol: Path


def trial(fault: Fault, folder: Path, at_s: float, seed: int) -> FaultTrial:
    """Run one trial in virtual time."""
    out = folder / "out"
    rig_file, protocol = folder / "rig.yaml", folder / "protocol.yaml"
    rig_file.write_text(fault.injection.edit_rig(rig_text(f"faults-{seed}", fault.bench)))
    protocol.write_text(fault.bench.protocol.format(moving_s=fault.moving_s))

    class ThisPlant(FaultyPlant):
        """The plant of this trial."""

    plant = ThisPlant
    plant.fault_ns = START_NS + round(at_s * 1e9)
    listener = Listener()
    with ExitStack() as stack:
        try:
            injection = fault.injection.prepared(folder, stack)
        except UnsupportedFaultError as why:
            return skipped(fault, "virtual", at_s, str(why))
        plant.on_fault = lambda faults: injection.inject(VirtualTarget(faults, out, rig_file, protocol))
        stack.enter_context(patch("rig.virtual.executor.Plant", plant))
        prepared = prepare(str(protocol), str(rig_file), RunOptions(out=out, fast=True, seed=seed, report=False))
        result = experiment.run(prepared, listener)
        with contextlib.suppress(FileNotFoundError):
            (out / "filler").unlink()
        output = "\n".join((*listener.output, result.outcome.message, *result.warnings, ""))
        return judge(fault, "virtual", at_s, TrialObservation(plant.fault_ns, plant.made.safe_ns, output), out)
