"""Set-point of one actuator over one segment, as a function of the time since the segment's start.

Each waveform gives its value and its slope in closed form, and `knots`: times between which both are monotone, so
that extremes are found without sampling (a fade is sampled). Values may be in any unit; a trajectory uses Pa.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from protocols.arrays import Array

FADE_KNOTS = 200


class Waveform(Protocol):
    """A value over time."""

    def at(self, t_s: float) -> float:
        """The value."""

    def slope(self, t_s: float) -> float:
        """Its rate of change per second."""

    def knots(self, duration_s: float) -> tuple[float, ...]:
        """Times from 0 to `duration_s`, both included, with every extreme of value and slope among them."""

    def values_at(self, t_s: Array) -> Array:
        """The values (n,) at times (n,)."""
        return np.array([self.at(t) for t in t_s.tolist()], dtype=np.float64)

    def slopes_at(self, t_s: Array) -> Array:
        """The slopes (n,) at times (n,)."""
        return np.array([self.slope(t) for t in t_s.tolist()], dtype=np.float64)


@dataclass(frozen=True)
class LinearSegment(Waveform):
    """From `start` at a constant slope, `stop` exactly at `duration_s`."""

    start: float
    stop: float
    duration_s: float

    def at(self, t_s: float) -> float:
        if t_s >= self.duration_s:
            return self.stop
        return self.start + (self.stop - self.start) * (t_s / self.duration_s)

    def slope(self, t_s: float) -> float:
        return (self.stop - self.start) / self.duration_s

    def knots(self, duration_s: float) -> tuple[float, ...]:
        """Both ends."""
        return (0.0, duration_s)


@dataclass(frozen=True)
class Smooth(Waveform):
    """From `start` to `stop` in `duration_s`, at rest and unaccelerated at both ends (quintic)."""

    start: float
    stop: float
    duration_s: float

    def at(self, t_s: float) -> float:
        if t_s >= self.duration_s:
            return self.stop
        return self.start + (self.stop - self.start) * _rise(t_s / self.duration_s)

    def slope(self, t_s: float) -> float:
        return (self.stop - self.start) / self.duration_s * _rise_slope(min(t_s / self.duration_s, 1.0))

    def knots(self, duration_s: float) -> tuple[float, ...]:
        """Both ends, and the middle of the whole rise, where it is steepest."""
        steepest_s = self.duration_s / 2
        return (0.0, steepest_s, duration_s) if steepest_s < duration_s else (0.0, duration_s)


@dataclass(frozen=True)
class Sinusoid(Waveform):
    """mean + amplitude sin(omega t + phase)."""

    mean: float
    amplitude: float
    omega_rad_s: float
    phase_rad: float

    def at(self, t_s: float) -> float:
        return self.mean + self.amplitude * math.sin(self.omega_rad_s * t_s + self.phase_rad)

    def slope(self, t_s: float) -> float:
        return self.amplitude * self.omega_rad_s * math.cos(self.omega_rad_s * t_s + self.phase_rad)

    def knots(self, duration_s: float) -> tuple[float, ...]:
        """Both ends, and the quarter turns of the first period."""
        first = math.ceil(self.phase_rad / (math.pi / 2))
        turns = ((k * math.pi / 2 - self.phase_rad) / self.omega_rad_s for k in range(first, first + 4))
        return (0.0, *(t for t in turns if 0 < t < duration_s), duration_s)


@dataclass(frozen=True)
class SinusoidLeadIn(Waveform):
    """From a constant into a sinusoid: it goes over smoothly in `duration_s` and never leaves the range of the two.

    `target` is the sinusoid as it will run afterwards; here it has its first value at `duration_s`.
    """

    start: float
    target: Sinusoid
    duration_s: float

    def at(self, t_s: float) -> float:
        weight = _rise(min(t_s / self.duration_s, 1.0))
        return self.start + weight * (self.target.at(t_s - self.duration_s) - self.start)

    def slope(self, t_s: float) -> float:
        portion, before = min(t_s / self.duration_s, 1.0), t_s - self.duration_s
        change = _rise_slope(portion) / self.duration_s * (self.target.at(before) - self.start)
        return change + _rise(portion) * self.target.slope(before)

    def knots(self, duration_s: float) -> tuple[float, ...]:
        """A fine grid: its extremes have no closed form."""
        return tuple(duration_s * i / FADE_KNOTS for i in range(FADE_KNOTS + 1))


@dataclass(frozen=True)
class Samples(Waveform):
    """Given values at given times from 0 on; between them a straight line, or, with `held`, the last value."""

    times_s: tuple[float, ...]
    values: tuple[float, ...]
    held: bool

    def at(self, t_s: float) -> float:
        i = bisect_right(self.times_s, t_s) - 1
        if i + 1 >= len(self.times_s):
            return self.values[-1]
        if i < 0 or self.held:
            return self.values[max(i, 0)]
        portion = (t_s - self.times_s[i]) / (self.times_s[i + 1] - self.times_s[i])
        return self.values[i] + (self.values[i + 1] - self.values[i]) * portion

    def slope(self, t_s: float) -> float:
        i = bisect_right(self.times_s, t_s) - 1
        if self.held or i < 0 or i + 1 >= len(self.times_s):
            return 0.0
        return (self.values[i + 1] - self.values[i]) / (self.times_s[i + 1] - self.times_s[i])

    def knots(self, duration_s: float) -> tuple[float, ...]:
        """Both ends, and the given times between them."""
        return (0.0, *(t for t in self.times_s if 0 < t < duration_s), duration_s)

    def values_at(self, t_s: Array) -> Array:
        """The values (n,), without a loop: a tip path has hundreds of thousands."""
        times, values = self._arrays
        left = np.searchsorted(times, t_s, side="right") - 1
        inside = np.clip(left, 0, max(len(times) - 2, 0))
        if self.held or len(times) < 2:
            return values[np.maximum(left, 0)]
        rise = values[inside + 1] - values[inside]
        found: Array = values[inside] + rise * ((t_s - times[inside]) / (times[inside + 1] - times[inside]))
        return np.where(left < 0, values[0], np.where(left + 1 >= len(times), values[-1], found))

    def slopes_at(self, t_s: Array) -> Array:
        """Their rates of change per second (n,)."""
        times, values = self._arrays
        left = np.searchsorted(times, t_s, side="right") - 1
        if self.held or len(times) < 2:
            return np.zeros(len(t_s))
        inside = np.clip(left, 0, len(times) - 2)
        slopes = (values[inside + 1] - values[inside]) / (times[inside + 1] - times[inside])
        return np.where((left < 0) | (left + 1 >= len(times)), 0.0, slopes)

    @cached_property
    def _arrays(self) -> tuple[Array, Array]:
        return np.array(self.times_s), np.array(self.values)


def _rise(x: float) -> float:
    """From 0 to 1 over 0..1 with zero slope and curvature at both ends (quintic)."""
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def _rise_slope(x: float) -> float:
    return 30.0 * x * x * (1.0 - x) * (1.0 - x)
