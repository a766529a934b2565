"""A plan of the tip controller as it goes from process to process: a row of fixed size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from runs.records import tip_control_dtype

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
