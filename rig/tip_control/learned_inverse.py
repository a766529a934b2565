"""Runs that learn: the feed-forward of a tip path, corrected by what earlier runs of the same experiment show."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.units import PA_PER_BAR
from protocols.tip_inverse import HISTORY_STEP_S, TipInverse, TipRequest, TipSolution
from protocols.tip_paths import fade
from rig.tip_control.interface import TipControlSettings
from rig.tip_control.learning import STEP_S, DisturbanceLearner, PathPeriod, Repetition
from runs.interpolation import interpolated
from runs.records import Status
from runs.run import Run

LONGEST_GAP_S = 0.25
"""Longest time without a measured tip in a motion from which something is learned."""
HISTORY_S = 1.0


class NotRepeatedError(ValueError):
    """An earlier run from which nothing can be learned; the message says what is expected instead."""


@dataclass(frozen=True, eq=False)
class EarlierRun:
    """An earlier run; `rows` are those of all its motions."""

    run_id: str
    rows: Repetition

    @classmethod
    def of(cls, run: Run, first_actuators: list[int]) -> EarlierRun:
        """The rows of a run whose tip was measured on its paths; `first_actuators` (V,): index of one of each valve.

        Raises:
            NotRepeatedError: nothing can be learned from the run.
        """
        if run.status is not Status.FINISHED:
            raise NotRepeatedError(f"a finished run; this one was {run.status}")
        reference, tip, pressure, learned = run.reference, run.tip, run.pressure, run.learning
        if reference is None:
            raise NotRepeatedError("a run with a tip path")
        frame_s = np.interp(tip.time_s, pressure.time_s, pressure.protocol_s)
        seen = (reference.motion > 0) & np.isfinite(tip.measured_mm).all(axis=1)
        for motion in range(1, int(reference.motion.max()) + 1):
            in_motion, found = frame_s[reference.motion == motion], frame_s[seen & (reference.motion == motion)]
            gaps = np.diff(np.concatenate([in_motion[:1], found, in_motion[-1:]]))
            if len(gaps) and gaps.max() > LONGEST_GAP_S:
                found_s = f"{gaps.max():.2f} s of a tip path without one"
                raise NotRepeatedError(f"a run with a measured tip every {LONGEST_GAP_S:g} s; this one has {found_s}")
            # At the start of a motion the protocol may have waited for a prompt.
            moving = (pressure.protocol_s > in_motion[0]) & (pressure.protocol_s <= in_motion[-1])
            if (np.diff(pressure.protocol_s[moving]) <= 0).any():
                raise NotRepeatedError("a run that was not paused on its tip paths")
        samples = _last_of_equal(pressure.protocol_s)
        frames = np.flatnonzero(seen)[_last_of_equal(frame_s[seen])]
        rows = Repetition(
            pressure.protocol_s[samples],
            PA_PER_BAR * pressure.setpoint_bar[samples][:, first_actuators],
            frame_s[frames],
            1e-3 * tip.measured_mm[frames],
            np.zeros((len(frames), 3)) if learned is None else 1e-3 * learned.disturbance_mm[frames],
        )
        return cls(run.header.run_id, rows)

    def repetition(self, begin_s: float, stop_s: float) -> Repetition:
        """The motion between two protocol times."""
        rows = self.rows
        frames = (rows.frame_s >= begin_s) & (rows.frame_s < stop_s)
        samples = (rows.sample_s >= begin_s - HISTORY_S) & (rows.sample_s <= stop_s)
        return Repetition(
            rows.sample_s[samples], rows.setpoint_pa[samples],
            rows.frame_s[frames], rows.tip_m[frames], rows.learned_m[frames],
        )  # fmt: skip


def _period(request: TipRequest) -> PathPeriod | None:
    """What a path repeats; None for one that is not followed at least twice."""
    period_s = request.path.period_s
    if period_s is None or request.path.duration_s < 2 * period_s:
        return None
    return PathPeriod(period_s, request.begin_s, request.lead_in_s)


def _last_of_equal(times_s: Array) -> NDArray[np.bool_]:
    """Which of the times (n,), none before an earlier one, are the last of those equal to them."""
    return np.append(np.diff(times_s) > 0, np.ones(min(1, len(times_s)), dtype=np.bool_))


class LearnedInverse:
    """The `TipInverse` of a rig, with the corrections that earlier runs give."""

    def __init__(self, inverse: TipInverse, settings: TipControlSettings, runs: tuple[EarlierRun, ...]) -> None:
        self._inverse, self._runs = inverse, runs
        self._learner = DisturbanceLearner(settings)
        self._valve_of = list(settings.valve_of)
        self._actuators = [self._valve_of.index(valve) for valve in range(settings.valves)]

    def solve(self, request: TipRequest) -> TipSolution:
        """The feed-forward set-points of a path, corrected.

        Raises:
            TipRefusedError: the rig cannot follow the path.
        """
        found = self._inverse.solve(request)
        duration_s = request.lead_in_s + request.path.duration_s
        steps = math.ceil(duration_s / STEP_S)
        step_s = duration_s / steps
        times: Array = step_s * np.arange(steps + 1, dtype=np.float64)
        stop_s = request.begin_s + duration_s
        learned = self._learner.disturbance(
            [run.repetition(request.begin_s, stop_s) for run in self._runs], request.begin_s + times, _period(request)
        )
        target, _ = fade(found.start, request.path, request.lead_in_s, times - request.lead_in_s)
        target[:, [axis for axis in range(3) if axis not in request.coordinates]] = np.nan
        feedforward = interpolated(times, found.times_s, found.pressure_pa[:, self._actuators])
        given = -HISTORY_STEP_S * np.arange(len(request.before_pa) - 1, -1, -1, dtype=np.float64)
        history: Array = np.arange(given[0], 0.0, step_s)
        before = interpolated(history, given, request.before_pa[:, self._actuators])
        setpoint = self._learner.setpoints(feedforward, before, target - learned, step_s)
        predicted = self._learner.tips(np.concatenate([before, setpoint]), step_s)[len(before) :] + learned
        return replace(
            found, times_s=times, pressure_pa=setpoint[:, self._valve_of], predicted_m=predicted, learned_m=learned
        )
