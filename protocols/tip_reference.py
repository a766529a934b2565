"""Reference trajectory of the tip over the time of a protocol, from its `tip` steps.

Positions are in metres in the rod-base frame. A coordinate that a step does not control is NaN.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocols.arrays import Array

GRID_S = 0.005
"""Sampling interval of a reference."""


@dataclass(frozen=True, eq=False)
class TipMotion:
    """One `tip` step: the lead-in from `start_s`, the path from `path_s` to `stop_s` [s, protocol time].

    times_s (n,) from `start_s` to `stop_s`, position_m and velocity_m_s (n, 3) at these times. `coordinates` are the
    controlled ones (0 x, 1 y, 2 z). `period_s` is that of the path, None if it does not repeat. `predicted_m` (n, 3)
    is the tip of the model under the feed-forward pressures; `learned_m` (n, 3) is the difference of the tip of the arm
    from it in earlier runs, zero without them. `line` is that of the step in the YAML of the protocol.
    """

    start_s: float
    path_s: float
    stop_s: float
    line: int
    label: str
    coordinates: tuple[int, ...]
    period_s: float | None
    tolerance_m: float
    times_s: Array = field(repr=False)
    position_m: Array = field(repr=False)
    velocity_m_s: Array = field(repr=False)
    predicted_m: Array = field(repr=False)
    learned_m: Array = field(repr=False)

    def positions_m(self, t_s: Array) -> Array:
        """Positions (m, 3) [m] at times (m,) within the motion: cubic Hermite interpolation of the samples."""
        left, share, step = self._place(t_s)
        before, after = self.position_m[left], self.position_m[left + 1]
        slope, next_slope = self.velocity_m_s[left] * step, self.velocity_m_s[left + 1] * step
        turn = 3 * (after - before) - 2 * slope - next_slope
        return before + share * (slope + share * (turn + share * (slope + next_slope - 2 * (after - before))))

    def velocities_m_s(self, t_s: Array) -> Array:
        """Velocities (m, 3) [m/s] at times (m,) within the motion, interpolated linearly."""
        return self._linear(self.velocity_m_s, t_s)

    def predictions_m(self, t_s: Array) -> Array:
        """Tips of the model (m, 3) [m] at times (m,) within the motion, interpolated linearly."""
        return self._linear(self.predicted_m, t_s)

    def learned_differences_m(self, t_s: Array) -> Array:
        """Learned differences between arm and model (m, 3) [m] at times (m,) within the motion."""
        return self._linear(self.learned_m, t_s)

    def learned_rates_m_s(self, t_s: Array) -> Array:
        """Their rates of change (m, 3) [m/s]."""
        left, _, step = self._place(t_s)
        return (self.learned_m[left + 1] - self.learned_m[left]) / step

    def _linear(self, values: Array, t_s: Array) -> Array:
        left, share, _ = self._place(t_s)
        return values[left] + share * (values[left + 1] - values[left])

    def _place(self, t_s: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Index of the sample before (m,), fraction of the interval to the next (m, 1), and its length (m, 1) [s]."""
        left = np.clip(np.searchsorted(self.times_s, t_s, side="right") - 1, 0, len(self.times_s) - 2)
        step = self.times_s[left + 1] - self.times_s[left]
        return left, ((t_s - self.times_s[left]) / step)[:, None], step[:, None]


@dataclass(frozen=True)
class TipReference:
    """The motions of a protocol in ascending order; between them there is no reference, nor at the end of a motion.

    After the end of the protocol its time does not advance, while the chambers vent.
    """

    motions: tuple[TipMotion, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.motions)

    def motion_at(self, t_s: float) -> TipMotion | None:
        """The motion at a protocol time, None where the tip has no reference."""
        index = bisect_right([motion.start_s for motion in self.motions], t_s) - 1
        return self.motions[index] if index >= 0 and t_s < self.motions[index].stop_s else None

    def position_m(self, t_s: float) -> Array:
        """Position (3,) [m] at a protocol time; NaN in a coordinate without a reference."""
        return self.sample([t_s]).reshape(3)

    def velocity_m_s(self, t_s: float) -> Array:
        """Velocity (3,) [m/s] at a protocol time; NaN in a coordinate without a reference."""
        return self._each([t_s], TipMotion.velocities_m_s).reshape(3)

    def sample(self, t_s: Iterable[float]) -> Array:
        """Positions (n, 3) [m] at n protocol times; NaN in a coordinate without a reference."""
        return self._each(t_s, TipMotion.positions_m)

    def predicted_m(self, t_s: Iterable[float]) -> Array:
        """Tips (n, 3) [m] of the model under the feed-forward pressures; NaN outside the motions."""
        return self._each(t_s, TipMotion.predictions_m)

    def learned_m(self, t_s: Iterable[float]) -> Array:
        """Learned differences between arm and model (n, 3) [m]; NaN outside the motions."""
        return self._each(t_s, TipMotion.learned_differences_m)

    def motion_and_period(self, t_s: float) -> tuple[int, int]:
        """Number of the motion, from 1, and of the path's period, from 1, at a protocol time.

        0 and 0 outside the motions; the period is 0 in a lead-in, and 1 on a path that does not repeat.
        """
        motion = self.motion_at(t_s)
        if motion is None:
            return 0, 0
        number = 1 + self.motions.index(motion)
        if t_s < motion.path_s:
            return number, 0
        if motion.period_s is None:
            return number, 1
        return number, max(1, math.ceil((t_s - motion.path_s) / motion.period_s - 1e-9))

    def _each(self, t_s: Iterable[float], value: Callable[[TipMotion, Array], Array]) -> Array:
        times = np.array(list(t_s), dtype=np.float64)
        found = np.full((len(times), 3), np.nan)
        for motion in self.motions:
            inside = (times >= motion.start_s) & (times < motion.stop_s)
            if inside.any():
                found[inside] = value(motion, times[inside])
        return found


NO_TIP_REFERENCE = TipReference()
