"""The interface of a tip controller: `step(state, reference, measurement) -> plan`, values only.

Times are protocol times [s], pressures gauge [Pa], positions [m] in the rod-base frame. V valves, N actuators: a valve
sets the pressure of all its actuators, so plans have one column for each valve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

import model
from model.arrays import Array
from runs.columns import SolveStatus as SolveStatus

AHEAD = 40
"""Points of the reference that a controller sees, half a camera period apart."""


@dataclass(frozen=True, eq=False)
class TipControlSettings:
    """What a controller knows of the rig; it is passed to the controller's constructor.

    `valve_of` (N,): index of the valve of each actuator. `delay_s`: from a frame to the plan that it leads to.
    `pressure_lag_s`: from a set-point to the pressure in the chamber. `learned`: earlier runs have shown how far the
    arm is from the model; measured tips and references are without that difference, the feed-forward makes up for it.
    """

    arm: model.Arm
    valve_of: tuple[int, ...]
    pressure_limit_pa: float
    rate_limit_pa_s: float
    frame_s: float
    delay_s: float
    pressure_lag_s: float
    learned: bool = False

    def reference_times(self, start_s: float) -> Array:
        """The times of a reference from the start of a plan on."""
        times: Array = start_s + 0.5 * self.frame_s * np.arange(AHEAD, dtype=np.float64)
        return times

    @property
    def valves(self) -> int:
        """Number of valves."""
        return max(self.valve_of) + 1


class ReferenceTrajectory(NamedTuple):
    """The reference at the times (H,) `times_s` from the start of the plan on, half a camera period apart.

    `position_m` and `velocity_m_s` (H, 3): NaN in a coordinate that is not controlled, and beyond the end of the
    path. `feedforward_pa` (H, V): the
    set-points of the protocol. `period_s`: of a path that repeats itself, else None.
    """

    times_s: Array
    position_m: Array
    velocity_m_s: Array
    feedforward_pa: Array
    period_s: float | None


class ControllerMeasurement(NamedTuple):
    """One camera frame, and the set-points and pressures up to the start of the plan.

    `time_s`, `tip_m` (3,), `covariance_m2` (3, 3): of the frame, NaN if the tip was not measured. `sample_s` (k,) in
    ascending order, `setpoint_pa`, `pressure_pa` (k, V): control cycles of at least the last camera periods; the last
    one is at or after the frame. `start_s`: time from which the plan is followed.
    """

    time_s: float
    tip_m: Array
    covariance_m2: Array
    sample_s: Array
    setpoint_pa: Array
    pressure_pa: Array
    start_s: float


class SetPointPlan(NamedTuple):
    """Set-points (K, V) `setpoint_pa` at ascending times (K,) `times_s`, linear in between.

    `state` is for the next step. `predicted_m` (K, 3): the tip that the controller expects at these times, NaN if it
    does not predict. `active`: active constraints of the solver, `iterations` its iterations. `nis`: normalised
    innovation squared of the frame, NaN without an estimator.
    """

    times_s: Array
    setpoint_pa: Array
    predicted_m: Array
    state: Any
    status: SolveStatus = SolveStatus.SOLVED
    iterations: int = 0
    active: int = 0
    nis: float = float("nan")


class TipController(Protocol):
    """A controller: constructed once per run from `TipControlSettings`, then stepped once per camera frame."""

    def start(self) -> Any:
        """The state before the first step."""

    def step(self, state: Any, reference: ReferenceTrajectory, measurement: ControllerMeasurement) -> SetPointPlan:
        """The plan that follows from one frame. A pure function: all memory is in the state."""
