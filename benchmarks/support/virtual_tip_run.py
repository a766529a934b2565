"""Tip paths on a simulated rig in virtual time, without archive and pictures, for the benchmarks of tip control.

Control loop, interlocks, tip controller, valves and chambers are those of `rig run --fast`; a simulated tracker
measures the tip in place of the camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.support.inline_pipeline import InlinePipeline
from model.arrays import Array
from protocols import SetPointTrajectory
from protocols.tip_reference import TipMotion
from rig.config.schema import RigConfig
from rig.execution.plan import NullOperator, RunPlan
from rig.tip_control.horizon import HorizonControl
from rig.tip_control.interface import TipControlSettings
from rig.virtual import executor
from runs.records import Event, Picture, RunFooter


class KeptRecord:
    """A recorder that keeps cycles, frames and events in memory."""

    stalled_s = 0.0

    def __init__(self) -> None:
        self.cycles: list[NDArray[np.void]] = []
        self.frames: list[NDArray[np.void]] = []
        self.events: list[Event] = []
        self.unsolved = 0

    def samples(self, rows: NDArray[np.void]) -> None:
        """Keep control cycles."""
        self.cycles.append(rows.copy())

    def observations(self, rows: NDArray[np.void]) -> None:
        """Keep frames."""
        self.frames.append(rows.copy())

    def plans(self, rows: NDArray[np.void]) -> None:
        """Count the plans without a solution."""
        self.unsolved += int(np.count_nonzero(rows["status"]))

    def event(self, event: Event) -> None:
        """Keep an event."""
        self.events.append(event)

    def adaptations(self, rows: NDArray[np.void]) -> None:
        """Nothing is estimated online."""

    def streamed(self, rows: NDArray[np.void]) -> None:
        """No other program sends set-points."""

    def picture(self, picture: Picture) -> None:
        """There is no camera."""


_BUILT: dict[str, HorizonControl] = {}


class SharedHorizon(HorizonControl):
    """The horizon controller, built once for each settings: it is a pure function, and its maps take time."""

    def __new__(cls, settings: TipControlSettings) -> Any:
        """The controller of equal settings, if there is one."""
        key = repr(settings)
        if key not in _BUILT:
            _BUILT[key] = HorizonControl(settings)
        return _BUILT[key]


SHARED_HORIZON = f"{__name__}:{SharedHorizon.__name__}"


@contextmanager
def in_this_process() -> Iterator[None]:
    """Let runs in virtual time measure their frames in this process."""
    usual = executor.FramePipeline
    executor.FramePipeline = InlinePipeline  # type: ignore[misc,assignment]
    try:
        yield
    finally:
        executor.FramePipeline = usual  # type: ignore[misc]


def distances_m(record: KeptRecord, motion: TipMotion, from_s: float) -> Array:
    """Distances (n,) of the true tip from the reference in the controlled coordinates, after a protocol time.

    `protocol_s` of a frame is that of the cycle before it, so the last frames may be beyond the path and have no
    reference.
    """
    frames, axes = np.concatenate(record.frames), list(motion.coordinates)
    counted = frames[(frames["protocol_s"] > from_s) & (frames["protocol_s"] < motion.stop_s)]
    counted = counted[np.isfinite(counted["reference_m"][:, axes]).all(axis=1)]
    found: Array = np.linalg.norm((counted["truth_m"] - counted["reference_m"])[:, axes], axis=1)
    return found


def perform(
    config: RigConfig, trajectory: SetPointTrajectory, seed: int, controller: str = SHARED_HORIZON
) -> tuple[KeptRecord, RunFooter]:
    """Run a trajectory in this process; what was recorded, and how it ended."""
    record = KeptRecord()
    plan = RunPlan(config, Path("drawn.yaml"), trajectory, config.model.variant, seed, (), controller)
    with in_this_process():
        return record, executor.run(plan, lambda t_ns: record, NullOperator())
