"""Where set-points come from: a trajectory, another program (`stream_follower`), a tip controller (`plan_follower`).

Every source gives `at(moment, below)`; `rig.control.limiter` keeps them within the limits of the rig.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from model.arrays import Array
from protocols import SetPointTrajectory
from rig.control.interlocks.base import Silence


class SetPoint(NamedTuple):
    """Set-points (N,) [Pa] and their rates of change (N,) [Pa/s]."""

    pressure_pa: Array
    rate_pa_s: Array


class Moment(NamedTuple):
    """A control cycle: its protocol time, the time since the last cycle, and whether the protocol stands still.

    `last_pa`: the set-points (N,) of the last cycle; None in the first.
    """

    protocol_s: float
    dt_s: float
    stopped: bool = False
    last_pa: Array | None = None


class LiveSetPoints(Protocol):
    """Set-points that are not known before the run."""

    @property
    def silence(self) -> Silence | None:
        """For how long none has come; None while none is due."""

    def at(self, now: Moment, below: SetPoint) -> SetPoint | None:
        """The set-points of a cycle, before any limit; None while those of the source below hold, the trajectory."""

    def skip(self) -> None:
        """The protocol goes on with its next segment."""


class RunSetPoints:
    """The set-points of a run: those of the trajectory, unless a live source has others."""

    def __init__(self, trajectory: SetPointTrajectory, live: tuple[LiveSetPoints, ...]) -> None:
        self._trajectory, self._live = trajectory, live
        self.live = False
        """Whether a live source gave those of the last cycle."""

    def at(self, now: Moment) -> SetPoint:
        """The set-points of a cycle, before any limit."""
        pressure_pa = self._trajectory.setpoint_pa(now.protocol_s)
        rate_pa_s = np.zeros_like(pressure_pa) if now.stopped else self._trajectory.rate_pa_s(now.protocol_s)
        point, self.live = SetPoint(pressure_pa, rate_pa_s), False
        for source in self._live:
            if (found := source.at(now, point)) is not None:
                point, self.live = found, True
        return point

    @property
    def silences(self) -> tuple[Silence, ...]:
        """Of the live sources from which set-points are due now."""
        return tuple(silence for source in self._live if (silence := source.silence) is not None)

    def skip(self) -> None:
        """The protocol goes on with its next segment."""
        for source in self._live:
            source.skip()
