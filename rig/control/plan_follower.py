"""Time-stamped plans: as rows of fixed size between processes, and as the control loop follows them."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from rig.control.interlocks.base import Silence
from rig.control.setpoints import Moment, SetPoint
from runs.columns import FOLLOWED_S
from runs.records import SolveStatus, tip_control_dtype

CORRECTION_S = 2.0
"""Time constant with which the slow part of the last correction decays: it belongs to where the tip was."""
SLOW_S = 1.0
"""Time constant of the low-pass filter that gives the slow part: what changes faster changes along the path, and would
be wrong a moment later."""
LARGEST_CORRECTION = 0.25
"""Largest correction that goes on without plans, as a share of the pressure limit: a fault may have made it."""
HANDOVER_S = 0.15
"""Time constant of the rest of the correction, and of the return to plans: about the period of the arm's first mode."""
TOLERANCE_PA = 1.0
"""How far a set-point may be out of limits by rounding; it is clipped."""
MOST_POINTS = 64
"""Largest number of points of a plan."""


class StampedPlan(NamedTuple):
    """A plan as the control loop follows it: times (K,) [protocol s] and set-points (K, V) [Pa]."""

    times_s: Array
    setpoint_pa: Array

    @classmethod
    def checked(cls, times_s: object, setpoint_pa: object, valves: int) -> StampedPlan:
        """The plan of a controller, which may be code of the user.

        Raises:
            TypeError: an array has no real numbers.
            ValueError: more than MOST_POINTS points, or not a set-point of every valve at each.
        """
        times, setpoints = np.asarray(times_s), np.asarray(setpoint_pa)
        for name, array in (("times_s", times), ("setpoint_pa", setpoints)):
            if array.dtype.kind not in "iuf":
                raise TypeError(f"{name} of a plan are real numbers; found an array of {array.dtype}")
        if times.ndim != 1 or len(times) > MOST_POINTS or setpoints.shape != (len(times), valves):
            expected = f"at most {MOST_POINTS} times, and a set-point of each of {valves} valves at each"
            raise ValueError(f"a plan has {expected}; found arrays of shape {times.shape} and {setpoints.shape}")
        return cls(times.astype(np.float64), setpoints.astype(np.float64))

    @classmethod
    def of(cls, record: NDArray[np.void] | np.void) -> StampedPlan:
        """The plan of a record of `plan_dtype`."""
        points = min(max(0, int(record["points"])), MOST_POINTS)
        return cls(record["times_s"][:points].copy(), record["setpoint_pa"][:points].copy())


def plan_dtype(valves: int) -> np.dtype[np.void]:
    """One plan: its row of the archive, and its first `points` times and set-points."""
    return np.dtype(
        [
            ("row", tip_control_dtype(valves)),
            ("points", "<i8"),
            ("times_s", "<f8", (MOST_POINTS,)),
            ("setpoint_pa", "<f8", (MOST_POINTS, valves)),
        ]
    )


def record_of(plan: StampedPlan, row: NDArray[np.void] | np.void) -> NDArray[np.void]:
    """The record of a plan of V valves, which has been checked, with its row of the archive."""
    record = np.zeros((), plan_dtype(row["plan_pa"].shape[-1]))
    points = len(plan.times_s)
    record["row"], record["points"] = row, points
    record["times_s"][:points], record["setpoint_pa"][:points] = plan.times_s, plan.setpoint_pa
    return record


class SetPointSource(IntEnum):
    """Where the set-points come from.

    PROTOCOL: no plan has come yet, or the tip has no reference. LOST: no plan since FOLLOWED_S, the tip is without
    feedback: the set-points are those of the protocol and the last correction.
    """

    PROTOCOL = 0
    PLAN = 1
    LOST = 2


class PlanFollower:
    """The set-points of the newest plan at a protocol time, on the tip paths of a protocol.

    Where a plan ends without a newer one, its correction (plan minus feed-forward) goes on, limited and decaying, on
    top of the protocol's set-points. Plans that come again are reached without a jump (bumpless transfer).
    """

    def __init__(
        self,
        valve_of: tuple[int, ...],
        limit_pa: float,
        no_plan_s: float = math.inf,
        on_path: Callable[[float], bool] = lambda protocol_s: True,
    ) -> None:
        """`valve_of` (N,): index of the valve of each actuator; `no_plan_s`: limit of `silence`.

        `on_path`: whether the tip has a reference at a protocol time.
        """
        self._valve_of, self._limit_pa, self._no_plan_s = list(valve_of), limit_pa, no_plan_s
        self._on_path = on_path
        self._times_s: Array = np.empty(0)
        self._setpoint_pa: Array = np.empty((0, max(valve_of) + 1))
        self._since_s: float | None = None
        self._silent_s = 0.0
        self._correction_pa: Array = np.zeros(len(valve_of))
        """Of the last cycle with a plan, which was at `_corrected_s`: set-points minus those of the protocol."""
        self._corrected_s = 0.0
        self._slow_pa: Array = np.zeros(len(valve_of))
        """The slow part of the correction."""
        self._return_pa: Array = np.zeros(len(valve_of))
        """Of the cycle at which plans came again, `_returned_s`: set-points minus those of the plan."""
        self._returned_s = 0.0
        self.source = SetPointSource.PROTOCOL

    @property
    def silence(self) -> Silence | None:
        """For how long no plan has begun; None where the tip has no reference."""
        if self._since_s is None:
            return None
        return Silence(
            "tip controller", self._silent_s, self._no_plan_s, "no plan of the tip controller", "tip_control, no_plan_s"
        )

    def take(self, protocol_s: float, times_s: Array, setpoint_pa: Array) -> SolveStatus | None:
        """Follow a plan from now on, or return why it is refused: then the old one is kept.

        Times (K,) must ascend and set-points (K, V) be finite and within the pressure limit. The plan must start
        within FOLLOWED_S of now, on a tip path, and not before the old one.
        """
        reason = self._refusal(protocol_s, times_s, setpoint_pa)
        if reason is None:
            self._times_s, self._setpoint_pa = times_s, setpoint_pa
        return reason

    def _refusal(self, protocol_s: float, times_s: Array, setpoint_pa: Array) -> SolveStatus | None:
        if not self._on_path(protocol_s):
            return SolveStatus.NO_PATH
        if times_s.ndim != 1 or not len(times_s) or setpoint_pa.shape != (len(times_s), max(self._valve_of) + 1):
            return SolveStatus.MALFORMED
        if not (np.isfinite(times_s).all() and np.isfinite(setpoint_pa).all()):
            return SolveStatus.NOT_FINITE
        if not (np.diff(times_s) > 0).all():
            return SolveStatus.MALFORMED
        if (setpoint_pa < -TOLERANCE_PA).any() or (setpoint_pa > self._limit_pa + TOLERANCE_PA).any():
            return SolveStatus.OUT_OF_LIMITS
        if abs(ahead_s := float(times_s[0]) - protocol_s) > FOLLOWED_S:
            return SolveStatus.EARLY if ahead_s > 0 else SolveStatus.LATE
        if len(self._times_s) and times_s[0] < self._times_s[0]:
            return SolveStatus.OUTDATED
        return None

    def skip(self) -> None:
        """Forget plan and correction: the protocol's set-points hold again."""
        self._times_s, self._since_s, self.source = self._times_s[:0], None, SetPointSource.PROTOCOL
        self._correction_pa = self._slow_pa = self._return_pa = np.zeros(len(self._valve_of))

    def at(self, now: Moment, below: SetPoint) -> SetPoint | None:
        """The set-points (N,) of a cycle before any limit; None before the first plan and where there is no path."""
        protocol_s = now.protocol_s
        if not self._on_path(protocol_s):
            self.skip()
            return None
        if len(self._times_s):
            self._since_s = float(self._times_s[0])
        elif self._since_s is None:
            self._since_s = protocol_s
        self._silent_s = protocol_s - self._since_s
        passed_s, feed_pa = protocol_s - self._corrected_s, below.pressure_pa
        wanted = feed_pa + self._slow_pa * math.exp(-passed_s / CORRECTION_S)
        wanted = wanted + (self._correction_pa - self._slow_pa) * math.exp(-passed_s / HANDOVER_S)
        planned = self._planned(protocol_s)
        if planned is not None:
            if self.source is SetPointSource.LOST:
                self._return_pa, self._returned_s = wanted - planned, protocol_s
            wanted = planned + self._return_pa * math.exp((self._returned_s - protocol_s) / HANDOVER_S)
            largest = LARGEST_CORRECTION * self._limit_pa
            self._correction_pa, self._corrected_s = np.clip(wanted - feed_pa, -largest, largest), protocol_s
            self._slow_pa = self._slow_pa + (self._correction_pa - self._slow_pa) * (1 - math.exp(-now.dt_s / SLOW_S))
            self.source = SetPointSource.PLAN
        elif self._silent_s > FOLLOWED_S:
            self.source = SetPointSource.LOST
        if self.source is SetPointSource.PROTOCOL:
            return None
        last = wanted if now.last_pa is None else now.last_pa
        moved = (wanted - last) / now.dt_s
        return SetPoint(wanted, moved if planned is not None else np.where(wanted == feed_pa, below.rate_pa_s, moved))

    def _planned(self, protocol_s: float) -> Array | None:
        """The set-points (N,) of the plan; None without a plan, and where it has ended."""
        if not len(self._times_s) or protocol_s > min(self._times_s[-1], self._times_s[0] + FOLLOWED_S):
            return None
        planned = np.array([np.interp(protocol_s, self._times_s, column) for column in self._setpoint_pa.T])
        return planned[self._valve_of]
