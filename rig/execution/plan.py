"""Inputs, results and interfaces of both executors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from protocols import SetPointTrajectory
from protocols.problems import bad_input
from rig.config.card_sections import CardConfig
from rig.config.drivers import Reality
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig, Variant
from rig.config.tip_controllers import FEED_FORWARD
from rig.config.tracker_sections import TrackerConfig
from runs.columns.observations import model_error_mm
from runs.columns.tip_control import reference_error_mm
from runs.records import AuxiliaryChannel, Event, Quantity, observation_dtype, sample_dtype

if TYPE_CHECKING:
    from runs.journal.journal import JournalWriter

UNRECORDED = "the record could not be written"
"""Prefix of the message of a run that ends because its journal fails."""


def sample_rows(config: RigConfig) -> np.dtype[np.void]:
    """The dtype of the rows of the control cycles of a rig."""
    return sample_dtype(config.actuators, len(config.valves), len(config.inputs), bool(valve_units(config)))


def valve_units(config: RigConfig) -> tuple[str, ...]:
    """The units of the valves' outputs; empty if every valve takes a voltage."""
    units = tuple(valve.output_unit for valve in config.valves)
    return () if set(units) <= {"V"} else units


def observation_rows(config: RigConfig) -> np.dtype[np.void]:
    """The dtype of the rows of the observer of a rig."""
    return observation_dtype(
        config.actuators, len(config.cameras), bool(config.trackers), config.triggered, len(config.sections)
    )


@dataclass(frozen=True)
class RunPlan:
    """The plan of one run; immutable."""

    config: RigConfig = field(repr=False)
    rig_file: Path
    trajectory: SetPointTrajectory = field(repr=False)
    variant: Variant
    seed: int
    adapted: tuple[Quantity, ...] = ()
    """Quantities that the recursive estimator estimates during the run; none by default."""
    tip_controller: str = ""
    """Name of the tip controller, or `package:Class`; empty for a protocol without a tip reference."""
    learned_from: tuple[str, ...] = ()
    """Ids of the earlier runs that have corrected the trajectory."""

    @property
    def auxiliary(self) -> tuple[AuxiliaryChannel, ...]:
        """The auxiliary inputs of the rig, in the order of the samples' column `aux`."""
        return tuple(AuxiliaryChannel(name, one.unit) for name, one in self.config.inputs.items())

    @property
    def controls_tip(self) -> bool:
        """Whether a controller corrects the set-points during the run."""
        return self.tip_controller not in ("", FEED_FORWARD)


@dataclass(frozen=True)
class Progress:
    """Progress for the display; `sample` and `observation` are the newest rows, None before the first.

    `missed` counts deadlines, `dropped` camera frames (None without a camera), both since the start of the run.
    """

    protocol_s: float
    duration_s: float
    sample: NDArray[np.void] | None
    observation: NDArray[np.void] | None
    missed: int
    dropped: int | None
    prompt: str | None
    paused: bool = False
    adapted: tuple[Quantity, ...] = ()
    adaptation: NDArray[np.void] | None = None
    """The newest row of the recursive estimator, in the order of `adapted`."""
    auxiliary: tuple[AuxiliaryChannel, ...] = ()
    """The auxiliary inputs, in the order of the sample's column `aux`."""

    @property
    def error_mm(self) -> float:
        """Distance of the measured tip from the model's; NaN without one."""
        return math.nan if self.observation is None else float(model_error_mm(np.array([self.observation]))[0])

    @property
    def path_error_mm(self) -> float:
        """Distance of the measured tip from its reference; NaN without one."""
        return math.nan if self.observation is None else float(reference_error_mm(np.array([self.observation]))[0])


class OperatorInterface(Protocol):
    """The operator's side of a run: the terminal or a script. A subclass inherits what shows and requests nothing."""

    def show(self, progress: Progress) -> None:
        """Show the progress; called about ten times a second."""
        return

    def report(self, event: Event) -> None:
        """Report an event; called for every event."""
        return

    def answered(self) -> bool:
        """True once when the operator has answered the prompt that is shown."""
        return False

    def stop_requested(self) -> str | None:
        """The reason of a stop request of the operator; None if there is none."""
        return None

    def pause_toggled(self) -> bool:
        """True once per request of the operator to pause or to resume."""
        return False


class NullOperator(OperatorInterface):
    """Null operator interface: shows nothing and requests nothing."""


class StartError(Exception):
    """The run could not start; the valves are safe and nothing was recorded."""


class StoppedError(StartError):
    """The operator stopped the run before it began."""


OpenRecord = Callable[[int], "JournalWriter"]
"""Called with the start time [ns] once everything is armed, before the first cycle: opens the journal."""


def require_mocks(rig: str, devices: Mapping[str, CardConfig | CameraConfig | TrackerConfig]) -> None:
    """Refuse virtual time for devices that only real time can drive, also those that another driver simulates.

    Raises:
        BadInputError: a device does not belong to the simulated bench.
    """
    if others := [name for name, device in devices.items() if device.reality is not Reality.SIMULATED]:
        found = f"virtual time on rig {rig}, with {', '.join(others)}"
        raise bad_input("--fast", found, "softrig's simulated bench (driver: mock); omit --fast for this rig")
