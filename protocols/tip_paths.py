"""Paths of the tip over time, in metres in the rod-base frame.

Time counts from the beginning of the path. Before 0 a periodic path has the values of the period before, any other its
first point; this is what a lead-in fades into. After the end the last point holds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols.arrays import Array


class TipPath(ABC):
    """A path: `duration_s`, and `period_s` if it repeats, else None. `has_corners`: its velocity jumps somewhere."""

    duration_s: float
    period_s: float | None
    has_corners: bool = False

    @abstractmethod
    def positions_m(self, t_s: Array) -> Array:
        """Positions (n, 3) [m] at times (n,)."""

    @abstractmethod
    def velocities_m_s(self, t_s: Array) -> Array:
        """Velocities (n, 3) [m/s] at times (n,)."""

    @abstractmethod
    def centre_m(self) -> Array:
        """The point (3,) [m] about which the path is scaled."""


@dataclass(frozen=True, eq=False)
class HarmonicPath(TipPath):
    """centre + sum over k of cosine_k cos(k phase) + sine_k sin(k phase), with phase 2 pi t / period; k from 1.

    cosines, sines: (K, 3) [m].
    """

    centre: Array
    cosines: Array
    sines: Array
    period_s: float
    duration_s: float

    def positions_m(self, t_s: Array) -> Array:
        angles, _ = self._angles(t_s)
        found: Array = self.centre + np.cos(angles) @ self.cosines + np.sin(angles) @ self.sines
        return found

    def velocities_m_s(self, t_s: Array) -> Array:
        angles, rate = self._angles(t_s)
        found: Array = (np.cos(angles) * rate) @ self.sines - (np.sin(angles) * rate) @ self.cosines
        return found

    def centre_m(self) -> Array:
        return self.centre

    def _angles(self, t_s: Array) -> tuple[Array, Array]:
        rate: Array = 2 * np.pi / self.period_s * np.arange(1.0, len(self.cosines) + 1)
        return np.minimum(t_s, self.duration_s)[:, None] * rate, rate


@dataclass(frozen=True, eq=False)
class PiecewisePath(TipPath):
    """Points (k, 3) [m] at ascending times (k,) from 0; between them straight lines.

    Each line is traversed at a constant speed, or, with `smooth`, at rest at both ends (quintic). `repeats` is how
    often the whole is traversed; then the first and the last point must be equal. `centre` (3,) is that of its shape.
    """

    times_s: Array
    points_m: Array
    smooth: bool
    repeats: float | None = None
    centre: Array | None = None

    @property
    def duration_s(self) -> float:  # type: ignore[override]
        """Time of all repetitions."""
        return self._once_s * (1.0 if self.repeats is None else self.repeats)

    @property
    def period_s(self) -> float | None:  # type: ignore[override]
        """Time of one repetition."""
        return None if self.repeats is None else self._once_s

    @property
    def has_corners(self) -> bool:  # type: ignore[override]
        """Straight lines at constant speeds meet in corners."""
        return not self.smooth

    @property
    def _once_s(self) -> float:
        return float(self.times_s[-1])

    def positions_m(self, t_s: Array) -> Array:
        left, share, _ = self._place(t_s)
        if self.smooth:
            share = smooth_weight(share)
        found: Array = self.points_m[left] + share[:, None] * (self.points_m[left + 1] - self.points_m[left])
        return found

    def velocities_m_s(self, t_s: Array) -> Array:
        left, share, inside = self._place(t_s)
        slope = 30 * share**2 * (1 - share) ** 2 if self.smooth else np.ones_like(share)
        slope = slope * inside / (self.times_s[left + 1] - self.times_s[left])
        found: Array = slope[:, None] * (self.points_m[left + 1] - self.points_m[left])
        return found

    def centre_m(self) -> Array:
        """The centre of the shape, or the middle of the box around the points."""
        if self.centre is not None:
            return self.centre
        return np.asarray((self.points_m.max(axis=0) + self.points_m.min(axis=0)) / 2)

    def _place(self, t_s: Array) -> tuple[NDArray[np.intp], Array, NDArray[np.bool_]]:
        """Index of the line (n,), fraction of its time (n,), and whether the time is within the path (n,)."""
        t = np.minimum(t_s, self.duration_s)
        inside = t_s < self.duration_s
        if self.repeats is None:
            inside = inside & (t >= 0)
            t = np.maximum(t, 0.0)
        else:
            last = t_s >= self.duration_s
            t = np.where(last, self._end_s(), np.mod(t, self._once_s))
        left = np.clip(np.searchsorted(self.times_s, t, side="right") - 1, 0, len(self.times_s) - 2)
        share = (t - self.times_s[left]) / (self.times_s[left + 1] - self.times_s[left])
        return left, np.clip(share, 0.0, 1.0), inside

    def _end_s(self) -> float:
        rest = float(np.mod(self.duration_s, self._once_s))
        return rest if rest > 1e-9 * self._once_s else self._once_s


@dataclass(frozen=True, eq=False)
class ScaledPath(TipPath):
    """Another path, faster by `speed` and larger by `size` about its centre."""

    path: TipPath
    speed: float = 1.0
    size: float = 1.0

    @property
    def duration_s(self) -> float:  # type: ignore[override]
        """Time of the path at this speed."""
        return self.path.duration_s / self.speed

    @property
    def period_s(self) -> float | None:  # type: ignore[override]
        """Period at this speed."""
        return None if self.path.period_s is None else self.path.period_s / self.speed

    @property
    def has_corners(self) -> bool:  # type: ignore[override]
        """Those of the path."""
        return self.path.has_corners

    def positions_m(self, t_s: Array) -> Array:
        centre = self.path.centre_m()
        return centre + self.size * (self.path.positions_m(t_s * self.speed) - centre)

    def velocities_m_s(self, t_s: Array) -> Array:
        return self.size * self.speed * self.path.velocities_m_s(t_s * self.speed)

    def centre_m(self) -> Array:
        return self.path.centre_m()


@dataclass(frozen=True, eq=False)
class TipStart:
    """State of the tip before a motion: position and velocity (3,) [m, m/s]."""

    position_m: Array
    velocity_m_s: Array


def smooth_weight(share: Array) -> Array:
    """Weights from 0 to 1 at fractions 0..1, with zero slope and curvature at both ends (quintic, as `Smooth`)."""
    weight: Array = share**3 * (10 + share * (6 * share - 15))
    return weight


def fade(start: TipStart, path: TipPath, lead_in_s: float, t_s: Array) -> tuple[Array, Array]:
    """Positions and velocities (n, 3) of a lead-in of `lead_in_s` and the path, at times (n,) since the path starts.

    During the lead-in the tip leaves its start, whose velocity dies away, with the quintic weight of `Smooth`. Before
    the lead-in it rests at the start.
    """
    position, velocity = path.positions_m(t_s), path.velocities_m_s(t_s)
    before = t_s < 0
    if lead_in_s <= 0 or not before.any():
        return position, velocity
    share = np.clip((t_s[before] + lead_in_s) / lead_in_s, 0.0, 1.0)[:, None]
    weight = smooth_weight(share)
    slope = 30 * share**2 * (1 - share) ** 2 / lead_in_s
    drift = lead_in_s * share * (1 - share) ** 3
    moving = t_s[before][:, None] > -lead_in_s * (1 + 1e-9)
    drift_rate = (1 - share) ** 2 * (1 - 4 * share) * moving
    origin = start.position_m + drift * start.velocity_m_s
    origin_rate = drift_rate * start.velocity_m_s
    target, target_rate = position[before], velocity[before]
    position[before] = origin + weight * (target - origin)
    velocity[before] = origin_rate + weight * (target_rate - origin_rate) + slope * (target - origin)
    return position, velocity


def closed_polyline(points_m: Sequence[Array]) -> Array:
    """The points (k + 1, 3) of a closed line through (k, 3) points."""
    points = np.array(points_m, dtype=np.float64)
    return np.vstack([points, points[:1]])


def length_m(path: TipPath) -> float:
    """Arc length of one period of a path, or of the whole path, by 4000 chords."""
    t = np.linspace(0.0, path.period_s or path.duration_s, 4001)
    return float(np.linalg.norm(np.diff(path.positions_m(t), axis=0), axis=1).sum())
