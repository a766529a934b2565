"""One trial in virtual time: the plant that the executor makes for itself is given its fault at a moment."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import ClassVar
from unittest.mock import patch

import numpy as np

import rig.config.loader
from rig.config.schema import RigConfig
from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.hardware.bench import Bench as Cards
from rig.realtime.timing_limits import STRICT_HUNG_S
from rig.simulator.faults import Faults
from rig.simulator.plant import Plant
from rig.virtual.executor import START_NS
from runs.records import Event
from scripts.faults import environment
from scripts.faults.catalogue import BenchFault, EnvironmentFault, Fault
from scripts.faults.environment import UnsupportedFaultError
from scripts.faults.fault_trial import PROTOCOL, FaultTrial, TrialObservation, judge, skipped

SEEN_SAFE_V = 0.01


class Listener(NullOperator):
    """An operator interface that stores messages."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def report(self, event: Event) -> None:
        """Remember."""
        self.said.append(event.message)


class FaultyPlant(Plant):
    """A plant that strikes itself at `fault_ns`, and watches its own outputs."""

    fault_ns = 0
    words: ClassVar[dict[str, float]] = {}
    on_fault: ClassVar[Callable[[], object]] = lambda: None
    made: ClassVar[FaultyPlant]

    def __init__(self, config: RigConfig, seed: int, t0_ns: int) -> None:
        super().__init__(config, seed, t0_ns, faults=Faults())
        self._safe_v = Cards(config, {}).safe_voltages
        self._due = True
        self.safe_ns: int | None = None
        type(self).made = self

    def advance(self, t_ns: int) -> None:
        """Let time pass, with the fault from its moment on."""
        if self._due and t_ns >= self.fault_ns:
            self._due = False
            super().advance(self.fault_ns)
            if self.words:
                self.faults.inject(**self.words)
            type(self).on_fault()
        super().advance(t_ns)

    def set_output(self, valve: int, volts: float) -> None:
        """Remember since when every output has been safe."""
        super().set_output(valve, volts)
        stands = np.array([self.output(i) for i in range(len(self._safe_v))])
        safe = bool(np.all(np.abs(stands - self._safe_v) < SEEN_SAFE_V))
        self.safe_ns = (self.safe_ns if self.safe_ns is not None else self.t_ns) if safe else None


def rig_text(action: object, device: str) -> str:
    """The mock rig with a card of its own, and a model that cannot be solved where that is the fault."""
    text = rig.config.loader.text("mock").replace("device: mock0", f"device: {device}")
    # Stated, so that the simulated bench is supervised as strictly as a real one.
    text = text.replace("\nlimits:\n", f"\nlimits:\n  hung_s: {STRICT_HUNG_S:g}\n")
    if action is EnvironmentFault.MODEL_UNSOLVABLE:
        text = text.replace("  cap_mass_g: 50\n", "  cap_mass_g: 5000\n")
        text = re.sub(r"a1_per_N: [\d.]+", "a1_per_N: 10.0", text, count=1)
    return text


def trial(fault: Fault, folder: Path, at_s: float, seed: int) -> FaultTrial:
    """Run one trial in virtual time."""
    out = folder / "out"
    rig_file, protocol = folder / "rig.yaml", folder / "protocol.yaml"
    rig_file.write_text(rig_text(fault.action, f"faults-{seed}"))
    protocol.write_text(PROTOCOL.format(moving_s=fault.moving_s))

    class ThisPlant(FaultyPlant):
        """The plant of this trial."""

    plant = ThisPlant
    plant.fault_ns = START_NS + round(at_s * 1e9)
    if isinstance(fault.action, BenchFault):
        plant.words = fault.action.words
    listener = Listener()
    with ExitStack() as stack:
        if fault.action is EnvironmentFault.DISK_FULL:
            try:
                stack.enter_context(environment.small_disk(out))
            except UnsupportedFaultError as why:
                return skipped(fault, "virtual", at_s, str(why))
            plant.on_fault = lambda: environment.fill(out)
        elif fault.action is EnvironmentFault.FILES_CHANGED:
            plant.on_fault = lambda: [path.write_text("spoilt: [") for path in (rig_file, protocol)]
        stack.enter_context(patch("rig.virtual.executor.Plant", plant))
        request = experiment.request(str(protocol), str(rig_file), folder=out, fast=True, seed=seed, report=False)
        result = experiment.run(request, experiment.plan(request), listener)
        with contextlib.suppress(FileNotFoundError):
            (out / "filler").unlink()
        said = "\n".join((*listener.said, result.outcome.message, *result.warnings, ""))
        return judge(fault, "virtual", at_s, TrialObservation(plant.fault_ns, plant.made.safe_ns, said), out)
