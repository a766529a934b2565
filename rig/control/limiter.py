"""The limits of pressure and rate: of the set-points of live sources, and of the reference that each valve follows.

`limited` is the only place in which they are applied, whatever the set-points come from.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from rig.config.schema import RigConfig
from rig.control.setpoints import Moment, SetPoint
from rig.valves.base import Regulator


def limited(
    wanted: float, last: float, largest_step: float, lowest: float = -math.inf, highest: float = math.inf
) -> float:
    """The value nearest to `wanted`, brought inside the box, that is within the largest step of the last value."""
    inside = min(max(wanted, lowest), highest)
    return min(max(inside, last - largest_step), last + largest_step)


class Limiter:
    """The set-points of the control cycles within the limits of a rig.

    A protocol is checked before the run: its set-points pass as they are, also a step, which the reference of each
    valve then follows at the rate limit. Live ones are limited here, and the protocol's until they are reached again.
    """

    def __init__(self, lowest_pa: float, highest_pa: float, rate_pa_s: float) -> None:
        self._box_pa, self._rate_pa_s = (lowest_pa, highest_pa), rate_pa_s
        self._returned = True
        self.last_pa: NDArray[np.float64] | None = None
        """The set-points (N,) of the last cycle; None before the first."""

    @classmethod
    def of(cls, config: RigConfig) -> Limiter:
        """The limiter of a rig."""
        limits = config.limits
        bars = limits.lowest_pressure_bar, limits.pressure_bar, limits.rate_bar_per_s
        return cls(*(PA_PER_BAR * bar for bar in bars))

    def limit(self, wanted: SetPoint, now: Moment, *, live: bool) -> SetPoint:
        """The set-points of a cycle; in a pause live ones stay. One that is limited has the rate at which it moves."""
        if self.last_pa is None or not (live or not self._returned):
            self.last_pa = wanted.pressure_pa
            return wanted
        largest_step = 0.0 if now.stopped else self._rate_pa_s * now.dt_s
        before = self.last_pa
        steps = zip(wanted.pressure_pa.tolist(), before.tolist(), strict=True)
        self.last_pa = np.array([limited(pressure, last, largest_step, *self._box_pa) for pressure, last in steps])
        kept = self.last_pa == wanted.pressure_pa
        self._returned = not live and bool(kept.all())
        moved_pa_s = (self.last_pa - before) / now.dt_s if now.dt_s > 0 else np.zeros(len(before))
        return SetPoint(self.last_pa, np.where(kept, wanted.rate_pa_s, moved_pa_s))


def reference_pa(settings: Regulator, before_pa: float, setpoint_pa: float, rate_pa_s: float, dt_s: float) -> float:
    """The reference of a valve after `dt_s`: exact for a ramp at its stated rate, first order for a step.

    Set-point and rate of change belong to the new instant.
    """
    carried = before_pa + rate_pa_s * dt_s
    wanted = carried + (setpoint_pa - carried) * (1.0 - math.exp(-settings.filter_per_s * dt_s))
    return limited(wanted, before_pa, settings.rate_limit_pa_s * dt_s)
