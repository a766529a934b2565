"""The live model: the shape of the arm at each frame, from the measured pressures and the loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

import model
from model.dynamics import Dynamics
from model.statics import statics
from rig.observation.sample_interpolator import SampleInterpolator

# After a longer gap, in periods of the camera, the model restarts from the static solution instead of catching up.
_MOST_STEPS = 10
_EVEN = 1e-6


class LiveModel:
    """The arm from frame to frame: statics at each frame, or dynamics over the time between two frames.

    Dynamics take equal steps of about the camera's stated period. An arm that remembers begins at the first sample
    known, and takes longer steps over a gap, however long: its past must not be lost.
    """

    def __init__(self, arm: model.Arm, period_s: float, static: bool) -> None:
        """The arm is observed every `period_s`; with `static` there are no dynamics, where possible."""
        self._remembers = arm.remembers
        # A static arm that remembers moves without inertia.
        moving = replace(arm, inertia=False) if static else arm
        self._dynamics = Dynamics(moving, period_s) if arm.remembers or not static else None
        self._solve: Callable[..., model.Shape] = partial(statics, arm, doubt_units=False)
        if self._dynamics is not None:
            self._solve = self._dynamics.start
        self._period_ns = period_s * 1e9
        self._last: tuple[int, model.Shape] | None = None

    def step(self, t_ns: int, pressures: SampleInterpolator, loads: model.Loads | None) -> model.Shape | None:
        """Return the arm's shape at the time of the next frame; None without convergence."""
        if self._dynamics is None:
            return self._at_rest(t_ns, pressures, loads)
        last, self._last = self._last, None
        if last is None and self._remembers:
            last = self._begin(t_ns, pressures, loads)
        passed_ns = t_ns - last[0] if last is not None else 0
        steps = max(1, round(passed_ns / self._period_ns))
        if self._remembers:
            steps = min(steps, _MOST_STEPS)
        if last is None or passed_ns <= 0 or steps > _MOST_STEPS:
            shape = self._at_rest(t_ns, pressures, loads)
        elif passed_ns * 1e-9 < self._dynamics.shortest_step_s:
            # Too short for the waves that the nodes resolve: the next frame takes a step over both.
            self._last = last
            return last[1]
        else:
            shape = None
            for k in range(1, steps + 1):
                pressure = pressures.at(last[0] + passed_ns * k // steps)
                finite = np.all(np.isfinite(pressure))
                shape = self._dynamics.step(pressure, loads, self._step_s(passed_ns / steps)) if finite else None
                if shape is None or not shape.ok:
                    # The next frame restarts from statics, because the history has a gap.
                    return None
        if shape is not None:
            self._last = t_ns, shape
        return shape

    def _begin(
        self, t_ns: int, pressures: SampleInterpolator, loads: model.Loads | None
    ) -> tuple[int, model.Shape] | None:
        """Time and shape at the first sample, at rest; None where there is none before the frame, or no solution."""
        first_ns = pressures.first_ns
        if first_ns is None or first_ns >= t_ns:
            return None
        shape = self._at_rest(first_ns, pressures, loads)
        return None if shape is None else (first_ns, shape)

    def _at_rest(self, t_ns: int, pressures: SampleInterpolator, loads: model.Loads | None) -> model.Shape | None:
        """The static shape at the pressures of a time."""
        pressure = pressures.at(t_ns)
        if not np.all(np.isfinite(pressure)):
            return None
        try:
            shape = self._solve(pressure, loads)
        except model.NotConverged:
            return None
        return shape if shape.ok else None

    def _step_s(self, step_ns: float) -> float | None:
        """The step, None for the stated period: times in whole nanoseconds do not count as uneven."""
        return None if abs(step_ns - self._period_ns) < _EVEN * self._period_ns else step_ns * 1e-9
