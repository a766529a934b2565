"""The course of a run up to its last pose: what walls and actuators have been through."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array

# The steps are as short as this, unless a run would take more of them than so many.
_STEP_S, _MOST_STEPS = 0.1, 1500


@dataclass(frozen=True)
class PressureCourse:
    """Pressures (T, N) [Pa], weights (T,) [kg] and wrenches (T, 6) [N, N m] in even steps of period_s, from rest.

    at (K,): the row of each pose.
    """

    period_s: float
    pressure_pa: Array
    weight_kg: Array
    wrench: Array
    at: NDArray[np.intp]

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> PressureCourse:
        """The course of some of the poses."""
        return replace(self, at=self.at[chosen])


def course_rows(first_s: float, pose_s: Array) -> tuple[Array, NDArray[np.intp]]:
    """Times (T,) of the rows of a course from first_s to the last of the poses' times (K,), and the poses' rows."""
    duration_s = max(float(pose_s.max()) - first_s, _STEP_S)
    count = int(np.clip(np.ceil(duration_s / _STEP_S), 1, _MOST_STEPS))
    time_s = np.linspace(first_s, first_s + duration_s, count + 1)
    return time_s, np.clip(np.rint((pose_s - first_s) / (duration_s / count)), 0, count).astype(np.intp)


def mean_around(time_s: Array, at_s: Array, values: Array) -> Array:
    """Means (T, N) of sampled values (n, N) over the step around each of the even times (T,)."""
    half = 0.5 * (time_s[1] - time_s[0])
    total = np.zeros_like(values)
    total[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(at_s)[:, None], axis=0)
    low, high = np.clip(time_s - half, at_s[0], at_s[-1]), np.clip(time_s + half, at_s[0], at_s[-1])
    width = (high - low)[:, None]
    out = np.empty((len(time_s), values.shape[1]))
    for n in range(values.shape[1]):
        sums = np.interp(high, at_s, total[:, n]) - np.interp(low, at_s, total[:, n])
        out[:, n] = np.where(
            width[:, 0] > 0, sums / np.maximum(width[:, 0], 1e-12), np.interp(time_s, at_s, values[:, n])
        )
    return out
