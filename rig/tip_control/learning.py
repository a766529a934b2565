"""Iterative learning over repeated runs: what earlier runs show of the arm beyond the controller's model.

Each run gives the difference between the measured tip and that of the model under the set-points that were commanded.
Its smooth part, a function of protocol time, is the disturbance that the next run expects (Schoellig, Mueller and
D'Andrea 2012): the feed-forward of the next run makes up for it, and the controller knows it over its whole horizon.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline, make_smoothing_spline
from scipy.ndimage import gaussian_filter1d

from model.arrays import Array
from model.inverse.static_map import StaticMap
from protocols.tip_paths import smooth_weight
from rig.tip_control.estimation.state import HARMONICS
from rig.tip_control.interface import TipControlSettings
from rig.tip_control.tip_dynamics import TipDynamics
from runs.interpolation import interpolated

STEP_S = 0.005
FADE_S = 0.5
"""Time at the beginning of a motion in which the correction of the feed-forward rises from zero."""
SMOOTHING_S = 0.03
"""Standard deviation of the Gaussian filter of a correction: corners of a path would need unlimited rates."""
CORRECTIONS = 3
LARGEST_HZ = 3.5
"""The frequency of which at most half is learned: beyond it the model's phase is not known well enough (the Q-filter of
iterative learning control).
"""
SLOWER = np.logspace(0, 2.25, 37)
"""How many times lower the frequency is of which half is learned: the smoothnesses that are compared."""
FEWEST_FRAMES = 5
"""In fewer frames a smooth part cannot be told from noise: nothing is learned."""
RATE_SHARE = 0.99
"""Share of the rate limit that a correction uses: times are rounded."""


@dataclass(frozen=True, eq=False)
class Repetition:
    """One motion of an earlier run; times are protocol times [s].

    `setpoint_pa` (n, V) at the control cycles (n,) `sample_s`, which begin before the motion. `tip_m` (m, 3) at the
    frames (m,) `frame_s` in which the tip was measured; `learned_m` (m, 3): the disturbance that the run was given.
    """

    sample_s: Array = field(repr=False)
    setpoint_pa: Array = field(repr=False)
    frame_s: Array = field(repr=False)
    tip_m: Array = field(repr=False)
    learned_m: Array = field(repr=False)


@dataclass(frozen=True)
class PathPeriod:
    """A path that repeats itself every `period_s`, after a lead-in that begins at `begin_s`."""

    period_s: float
    begin_s: float
    lead_in_s: float

    def waves(self, times_s: Array) -> Array:
        """Cosines and sines (k, 2 h) of the harmonics at times (k,), which rise over the lead-in as the path does."""
        most = max(1, min(HARMONICS, math.floor(LARGEST_HZ * self.period_s)))
        phase = 2 * np.pi / self.period_s * np.outer(times_s, np.arange(1, most + 1))
        share = (
            np.clip((times_s - self.begin_s) / self.lead_in_s, 0.0, 1.0) if self.lead_in_s else np.ones(len(times_s))
        )
        waves: Array = smooth_weight(share)[:, None] * np.hstack([np.cos(phase), np.sin(phase)])
        return waves


class DisturbanceLearner:
    """Learns the disturbance of an arm, and corrects the feed-forward for it."""

    def __init__(self, settings: TipControlSettings) -> None:
        self._settings = settings
        self._map = StaticMap.of(settings.arm, settings.valve_of, settings.pressure_limit_pa)
        self._dynamics = TipDynamics.of(settings.arm, settings.pressure_limit_pa)

    def disturbance(self, repetitions: Sequence[Repetition], times_s: Array, period: PathPeriod | None = None) -> Array:
        """The disturbance (k, 3) [m] at times (k,), from at least one repetition of the same motion.

        Each repetition corrects the estimate by the smooth part of what is left. `period`: of a path that repeats
        itself.
        """
        first = repetitions[0]
        estimate = _within(CubicSpline(first.frame_s, first.learned_m), first.frame_s, times_s)
        for one in repetitions:
            left = one.tip_m - self._model_tips(one) - interpolated(one.frame_s, times_s, estimate)
            estimate = estimate + _within(smooth(one.frame_s, left, period), one.frame_s, times_s)
        return estimate

    def tips(self, setpoint_pa: Array, step_s: float) -> Array:
        """Tips (n, 3) [m] of the model under set-points (n, V), `step_s` apart, from rest under the first."""
        drive = self._map.tips(_delayed(setpoint_pa, self._settings.pressure_lag_s / step_s))
        tips: Array = self._dynamics.advance(np.stack([drive[0], np.zeros(3)]), drive, step_s)[:, 0]
        return tips

    def setpoints(self, feedforward_pa: Array, before_pa: Array, target_m: Array, step_s: float) -> Array:
        """Set-points (n, V) under which the model's tip follows `target_m` (n, 3), within the limits of the rig.

        They correct a feed-forward (n, V) that follows a path without disturbance; `before_pa` (b, V) are the
        set-points before it, at the same step. A coordinate that is NaN is free.
        """
        rising = np.clip(step_s * np.arange(len(target_m)) / FADE_S, 0.0, 1.0)[:, None]
        rising = rising**2 * (3 - 2 * rising)
        setpoint = feedforward_pa
        for _ in range(CORRECTIONS):
            tips = self.tips(np.concatenate([before_pa, setpoint]), step_s)[len(before_pa) :]
            missing = rising * np.where(np.isnan(target_m), 0.0, target_m - tips)
            missing = gaussian_filter1d(missing, SMOOTHING_S / step_s, axis=0, mode="nearest")
            velocity = np.gradient(missing, step_s, axis=0)
            drive = missing + self._dynamics.tau_s * velocity
            drive += np.gradient(velocity, step_s, axis=0) / self._dynamics.omega_rad_s**2
            drive = _delayed(drive, -self._settings.pressure_lag_s / step_s)
            wanted = np.where(np.isnan(target_m), np.nan, self._map.tips(setpoint) + drive)
            setpoint = self._limited(self._map.inverse(wanted, setpoint), before_pa[-1], step_s)
        return setpoint

    def _model_tips(self, one: Repetition) -> Array:
        """Tips (m, 3) of the model at the frames of a repetition."""
        times = np.arange(one.sample_s[0], one.frame_s[-1] + STEP_S, STEP_S)
        tips = self.tips(interpolated(times, one.sample_s, one.setpoint_pa), STEP_S)
        return interpolated(one.frame_s, times, tips)

    def _limited(self, setpoint_pa: Array, before_pa: Array, step_s: float) -> Array:
        """The set-points within the rate limit, from those (V,) before them on; the inverse keeps the others."""
        room, last = RATE_SHARE * self._settings.rate_limit_pa_s * step_s, before_pa
        limited = np.empty_like(setpoint_pa)
        for k, wanted in enumerate(setpoint_pa):
            limited[k] = last = np.clip(wanted, last - room, last + room)
        return limited


def smooth(times_s: Array, values: Array, period: PathPeriod | None = None) -> Callable[[Array], Array]:
    """The smooth part, a function of time, of values (n, m) at ascending times (n,).

    It is a cubic smoothing spline, plus the waves of a path that repeats itself (partial spline, Speckman 1988): what
    is the same in each period is the mean over the periods, and need not be in the spline. The smoothness is that of
    the least generalised cross-validation (Craven and Wahba 1979), one for all columns; the spline's degrees of freedom
    are those of equally spaced times. White noise becomes almost zero. The values are used at their own times: values
    that are interpolated on a grid have a smooth noise, which would be learned.
    """
    count, columns = values.shape
    if count < FEWEST_FRAMES:
        return lambda t_s: np.zeros((len(t_s), columns))
    waves = np.empty((count, 0)) if period is None else period.waves(times_s)
    step_s = (times_s[-1] - times_s[0]) / (count - 1)
    penalties = (2 * np.pi * LARGEST_HZ / SLOWER) ** -4 / step_s
    curvature = (2 - 2 * np.cos(np.pi * np.arange(count) / count)) ** 2
    freedom = (1 / (1 + penalties[:, None] / step_s**3 * curvature)).sum(axis=1) + waves.shape[1]
    both = np.hstack([values, waves])
    found, scores = [], []
    for penalty, used in zip(penalties, freedom, strict=True):
        spline = make_smoothing_spline(times_s, both, lam=penalty)
        rough = both - spline(times_s)
        weights = np.linalg.lstsq(rough[:, columns:], rough[:, :columns])[0]
        found.append((spline, weights))
        scores.append(np.sum((rough[:, :columns] - rough[:, columns:] @ weights) ** 2) / (count - used) ** 2)
    spline, weights = found[int(np.argmin(scores))]

    def at(t_s: Array) -> Array:
        smooth_part = spline(t_s)
        known = np.empty((len(t_s), 0)) if period is None else period.waves(t_s)
        part: Array = smooth_part[:, :columns] + (known - smooth_part[:, columns:]) @ weights
        return part

    return at


def _within(function: Callable[[Array], Array], frame_s: Array, times_s: Array) -> Array:
    """Values of a function of time; before the first and after the last frame the nearest ones."""
    return np.asarray(function(np.clip(times_s, frame_s[0], frame_s[-1])))


def _delayed(values: Array, steps: float) -> Array:
    """Values (n, m) delayed by so many steps; at the ends the first and the last."""
    index = np.arange(len(values), dtype=np.float64)
    return interpolated(index - steps, index, values)
