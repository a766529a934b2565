"""What both executors are given and what they give back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from protocols import Trajectory
from rig.config.schema import RigConfig, Variant
from runs.records import Event, Picture, Quantity, Status


@dataclass(frozen=True)
class Plan:
    """One run, decided: nothing in it changes once it is armed."""

    config: RigConfig
    rig_file: Path
    trajectory: Trajectory
    variant: Variant
    seed: int
    adapted: tuple[Quantity, ...] = ()
    """What the recursive estimator estimates beside the run; nothing by default."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended. The valves were in their safe state before this existed."""

    status: Status
    message: str
    t_ns: int
    counters: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Progress:
    """What there is to see now; `sample` and `observation` are the newest rows, None before the first."""

    protocol_s: float
    duration_s: float
    sample: NDArray[np.void] | None
    observation: NDArray[np.void] | None
    missed: int
    prompt: str | None
    held: bool = False
    adapted: tuple[Quantity, ...] = ()
    adaptation: NDArray[np.void] | None = None
    """The newest row of the recursive estimator, in the order of `adapted`."""


class Recorder(Protocol):
    """Where the rows go: the journal."""

    @property
    def stalled_s(self) -> float:
        """For how long the disk has not taken what was recorded [s]."""

    def samples(self, rows: NDArray[np.void]) -> None:
        """Record control ticks."""

    def observations(self, rows: NDArray[np.void]) -> None:
        """Record camera frames."""

    def adaptations(self, rows: NDArray[np.void]) -> None:
        """Record what the recursive estimator found."""

    def picture(self, picture: Picture) -> None:
        """Record a camera picture."""

    def event(self, event: Event) -> None:
        """Record something that happened."""


class OperatorInterface(Protocol):
    """Who watches and answers: the terminal, a script."""

    def show(self, progress: Progress) -> None:
        """Called some ten times a second with what there is to see."""

    def tell(self, event: Event) -> None:
        """Called at every event."""

    def answered(self) -> bool:
        """True once when the operator has answered the prompt that is shown."""

    def stop_requested(self) -> str | None:
        """Why the operator wants the run to stop, None while he does not."""

    def pause_toggled(self) -> bool:
        """True once when the operator has asked for a pause, or for its end."""


class NullOperator:
    """An audience that looks away and never acts: a script's."""

    def show(self, progress: Progress) -> None:
        """Look away."""

    def tell(self, event: Event) -> None:
        """Forget."""

    def answered(self) -> bool:
        """Never."""
        return False

    def stop_requested(self) -> str | None:
        """Never."""
        return None

    def pause_toggled(self) -> bool:
        """Never."""
        return False


class StartError(Exception):
    """The run could not begin; the valves are safe and nothing was recorded."""


class StoppedError(StartError):
    """The operator stopped the run before it began."""


OpenRecord = Callable[[int], Recorder]
"""Called with the start time [ns] once everything is armed, before the first tick: opens the journal."""
