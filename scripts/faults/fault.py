"""A fault of the campaign: its name, its injection, the expected result; and the registry of all faults."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Protocol

from rig.simulator.faults import Faults
from runs.records import Status
from scripts.faults.trial_run import MOVING_S, PRESSURES, TrialBench, TrialRun


class FaultTarget(Protocol):
    """What a fault acts on in either executor: the faults of the simulated bench, and the files of the run."""

    faults: Faults
    out: Path
    rig_file: Path
    protocol: Path


@dataclass(frozen=True)
class FaultTrial:
    """The result of one fault at one moment. `wrong` lists the deviations from what is expected; empty if none.

    `safe_s` is the time from the fault to the safe state, NaN if the run finished.
    """

    fault: str
    executor: str
    at_s: float
    status: str
    message: str
    safe_s: float
    lost_s: float
    wrong: str
    skipped: str = ""


class Injection:
    """How a fault is injected. Subclasses are frozen dataclasses; each method has a default that does nothing."""

    terminal: ClassVar[bool] = False
    """Whether the run needs a terminal."""

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables of the run."""
        return {}

    def decided(self, fault: Fault, chance: random.Random) -> Fault:
        """The fault of one trial, for an injection that chooses at random."""
        return fault

    def edit_rig(self, text: str) -> str:
        """The text of the rig file, if the fault is in it."""
        return text

    def prepared(self, folder: Path, stack: ExitStack) -> Injection:
        """Prepare a trial in a folder before its run starts, undone by `stack`; return the injection to use.

        Raises:
            UnsupportedFaultError: this machine does not allow the fault.
        """
        return self

    def inject(self, target: FaultTarget) -> int | None:
        """Inject the fault in either executor; return as `inject_realtime`."""
        return None

    def inject_realtime(self, run: TrialRun) -> int | None:
        """Inject the fault into a real-time run.

        Returns the time [ns] at which the time to the safe state begins, if that is not the time of the call.
        """
        return self.inject(run)

    def trial(self, fault: Fault, folder: Path, at_s: float, seed: int) -> FaultTrial | None:
        """A real-time trial of its own; None for the trial of `scripts.faults.realtime`."""
        return None


@dataclass(frozen=True)
class Fault:
    """One fault. `says` is a pattern of the message to the operator; `safe` is false if no program can help.

    `ends` are the statuses that the archive may have.
    """

    name: str
    kind: str
    injection: Injection
    ends: tuple[Status, ...]
    says: str
    real: bool = True
    virtual: bool = True
    safe: bool = True
    within_s: float = 3.0
    """Time limit for safe valves if the run ends, from the injection."""
    remark: str = field(default="", kw_only=True)
    moving_s: float = field(default=MOVING_S, kw_only=True)
    """How long the protocol moves the valves."""
    bench: TrialBench = field(default=PRESSURES, kw_only=True)


class FaultRegistry(Mapping[str, Fault]):
    """The faults of the campaign by name."""

    def __init__(self, *faults: Fault) -> None:
        self._faults: dict[str, Fault] = {}
        for fault in faults:
            self.register(fault)

    def register(self, fault: Fault) -> None:
        """Add a fault.

        Raises:
            ValueError: the name is registered already.
        """
        if fault.name in self._faults:
            raise ValueError(f"a fault named '{fault.name}' is registered already")
        self._faults[fault.name] = fault

    def named_like(self, part: str) -> tuple[Fault, ...]:
        """The faults whose name contains `part`.

        Raises:
            KeyError: there is none; the message lists the known names.
        """
        found = tuple(fault for name, fault in self._faults.items() if part in name)
        if not found:
            raise KeyError(f"no fault is named like '{part}'; known are: {', '.join(self._faults)}")
        return found

    def __getitem__(self, name: str) -> Fault:
        return self._faults[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._faults)

    def __len__(self) -> int:
        return len(self._faults)
