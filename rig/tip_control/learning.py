"""Iterative learning over repeated runs: what earlier runs show of the arm beyond the controller's model.

Each run gives the difference between the measured tip and that of the model under the set-points that were commanded.
Its smooth part, a function of protocol time, is the disturbance that the next run expects (Schoellig, Mueller and
D'Andrea 2012): the feed-forward of the next run makes up for it, and the controller knows it over its whole horizon.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from model.inverse.static_map import StaticMap
from rig.tip_control.interface import TipControlSettings
from rig.tip_control.tip_dynamics import TipDynamics
from runs.interpolation import interpolated

Array = NDArray[np.float64]

STEP_S = 0.005
FADE_S = 0.5
"""Time at the beginning of a motion in which the correction of the feed-forward rises from zero."""
SMOOTHING_S = 0.03
"""Standard deviation of the Gaussian filter of a correction: corners of a path would need unlimited rates."""
CORRECTIONS = 3
SMOOTHNESS = 4 * np.logspace(0, 9, 73)
"""Penalties of the squared second differences that are compared. The least one halves 3.5 Hz at 30 frames a second:
beyond that the model's phase is not known well enough to learn (the Q-filter of iterative learning control).
"""
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


class DisturbanceLearner:
    """Learns the disturbance of an arm, and corrects the feed-forward for it."""

    def __init__(self, settings: TipControlSettings) -> None:
        self._settings = settings
        self._map = StaticMap.of(settings.arm, settings.valve_of, settings.pressure_limit_pa)
        self._dynamics = TipDynamics.of(settings.arm, settings.pressure_limit_pa)

    def disturbance(self, repetitions: Sequence[Repetition], times_s: Array) -> Array:
        """The disturbance (k, 3) [m] at times (k,), from at least one repetition of the same motion.

        Each repetition corrects the estimate by the smooth part of what is left.
        """
        first = repetitions[0]
        estimate = _within(CubicSpline(first.frame_s, first.learned_m), first.frame_s, times_s)
        for one in repetitions:
            left = one.tip_m - self._model_tips(one) - interpolated(one.frame_s, times_s, estimate)
            estimate = estimate + self._smoothed(one.frame_s, left, times_s)
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

    def _smoothed(self, frame_s: Array, values: Array, times_s: Array) -> Array:
        """The smooth part (k, 3) at times (k,) of values (m, 3) at frames."""
        grid = np.linspace(frame_s[0], frame_s[-1], 1 + round((frame_s[-1] - frame_s[0]) / self._settings.frame_s))
        return _within(CubicSpline(grid, smooth(interpolated(grid, frame_s, values))), frame_s, times_s)

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


def smooth(values: Array) -> Array:
    """The smooth part (n, m) of equally spaced values (n, m): Whittaker smoother of second order.

    The smoothness is that of the least generalised cross-validation, one for all columns; by the discrete cosine
    transform (Garcia 2010). White noise becomes almost zero.
    """
    count, waves = len(values), dct(values, axis=0, norm="ortho")
    curvature = (2 - 2 * np.cos(np.pi * np.arange(count) / count)) ** 2
    kept = 1 / (1 + SMOOTHNESS[:, None] * curvature)
    left = (((1 - kept)[:, :, None] * waves) ** 2).sum(axis=(1, 2))
    score = left / (count - kept.sum(axis=1)) ** 2
    found: Array = idct(kept[int(np.argmin(score))][:, None] * waves, axis=0, norm="ortho")
    return found


def _within(function: Callable[[Array], Array], frame_s: Array, times_s: Array) -> Array:
    """Values of a function of time; before the first and after the last frame the nearest ones."""
    return np.asarray(function(np.clip(times_s, frame_s[0], frame_s[-1])))


def _delayed(values: Array, steps: float) -> Array:
    """Values (n, m) delayed by so many steps; at the ends the first and the last."""
    index = np.arange(len(values), dtype=np.float64)
    return interpolated(index - steps, index, values)
