"""Follows time-stamped plans in the control loop, within the limits of the rig whatever a plan holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_S = 0.3
"""For how long after its start a plan is followed; then the set-points are held."""


class SetPoint(NamedTuple):
    """Set-points (V,) [Pa] and their rates of change (V,) [Pa/s]; `held` is true where there is no valid plan."""

    pressure_pa: Array
    rate_pa_s: Array
    held: bool


class PlanFollower:
    """The set-points of the newest plan at a protocol time, inside box and rate limit."""

    def __init__(self, valves: int, limit_pa: float, rate_limit_pa_s: float) -> None:
        self._valves, self._limit_pa, self._rate_pa_s = valves, limit_pa, rate_limit_pa_s
        self._times_s: Array = np.empty(0)
        self._setpoint_pa: Array = np.empty((0, valves))
        self._last: Array | None = None

    def take(self, times_s: Array, setpoint_pa: Array) -> bool:
        """Follow a plan from now on; False for one that is no plan: then the old one is kept.

        Times (K,) must ascend and set-points (K, V) be finite.
        """
        good = (
            times_s.ndim == 1
            and len(times_s) > 0
            and setpoint_pa.shape == (len(times_s), self._valves)
            and bool(np.isfinite(times_s).all() and np.isfinite(setpoint_pa).all())
            and bool((np.diff(times_s) > 0).all())
        )
        if good:
            self._times_s, self._setpoint_pa = times_s, setpoint_pa
        return good

    def drop(self) -> None:
        """Forget the plan: the protocol's set-points hold again."""
        self._times_s = self._times_s[:0]

    def follow(self, protocol_s: float, dt_s: float, feed_pa: Array, feed_rate_pa_s: Array) -> SetPoint:
        """The set-points at a protocol time, `dt_s` after those before; without a plan the protocol's (V,)."""
        held = False
        if len(self._times_s):
            t_s = min(protocol_s, self._times_s[-1])
            held = protocol_s > self._times_s[0] + LONGEST_S
            t_s = min(t_s, self._times_s[0] + LONGEST_S)
            wanted = np.array([np.interp(t_s, self._times_s, column) for column in self._setpoint_pa.T])
        else:
            wanted = feed_pa
        last = wanted if self._last is None else self._last
        room = self._rate_pa_s * dt_s
        limited = np.clip(np.clip(wanted, 0.0, self._limit_pa), last - room, last + room)
        if len(self._times_s):
            rate = (limited - last) / dt_s if dt_s > 0 else np.zeros(self._valves)
        else:
            rate = np.where(limited == feed_pa, feed_rate_pa_s, (limited - last) / dt_s if dt_s > 0 else 0.0)
        self._last = limited
        return SetPoint(limited, rate, held)
