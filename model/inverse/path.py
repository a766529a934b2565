"""Pressures under which the tip follows a path in time: inverse statics, then inverse dynamics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from model import sensitivities
from model.arm import Arm
from model.arrays import Array
from model.dynamics import Dynamics, SavedMotion
from model.inverse.drive import Drive
from model.inverse.limited_step import limited_step
from model.inverse.static_map import StaticMap
from model.loads import Loads
from model.variation import GRADIENT_STEP_PA, Variation

STATIC_STEPS = 5
DYNAMIC_STEPS = 8
STATIC_ENOUGH_M = 2e-4
"""Error at which the dynamic steps take over."""
COARSE_S = 0.05
"""Distance of the samples at which statics and gradients are solved."""
SMOOTHING_S = 0.015
"""Standard deviation of the filter of the correction: it removes what a second-order response does not describe."""
LEAST_PROGRESS = 0.9
SMALL_M = 1e-6
"""The dynamic steps end when the root mean square of the error falls by less than a tenth, or below this."""
RESPONSE_S = 0.5
RESPONSE_STEP_PA = 2000.0
WINDOW_S = 30.0
"""Longest part of a path that is solved at once,"""
AHEAD_S = 2.0
"""together with what comes in so long after it, and in the time in which the rate limit permits every pressure."""
GUESS = 0.25
"""First guess of the pressures, relative to their limit."""


@dataclass(frozen=True, eq=False)
class PathFollowing:
    """Pressures (n, V) [Pa] of the valves, and the tips (n, 3) [m] of the model in motion; NaN where it failed."""

    pressure_pa: Array
    tip_m: Array

    def error_m(self, target_m: Array, coordinates: tuple[int, ...]) -> Array:
        """Distance (n,) of tip and target (n, 3) in some coordinates."""
        axes = list(coordinates)
        return np.asarray(np.linalg.norm(self.tip_m[:, axes] - target_m[:, axes], axis=1))


@dataclass(frozen=True)
class SecondOrderResponse:
    """Second-order response of the tip: shift = tip + lag d/dt tip + inertia d2/dt2 tip [s, s^2]."""

    lag_s: float
    inertia_s2: float


@dataclass(frozen=True, eq=False)
class PathPlace:
    """Where a window of a path begins: the arm in motion with its tip (3,) [m], and the pressures (V,) [Pa].

    `ahead_pa` (a, V): the pressures after it that the window before has found, with the end of that window near.
    """

    motion: Dynamics
    saved: SavedMotion
    tip_m: Array
    pressure_pa: Array
    ahead_pa: Array


class PathInverse:
    """The inverse of one arm with its drive and a weight on the tip, on a grid of times `dt_s` apart."""

    def __init__(
        self,
        arm: Arm,
        drive: Drive,
        dt_s: float,
        loads: Loads | None = None,
        weight_kg: float = 0.0,
        static_map: StaticMap | None = None,
    ) -> None:
        """`loads` is what `weight_kg` exerts on the tip; `static_map` is that of the arm with it, if there is one."""
        self._arm, self._drive, self._dt_s = arm, drive, dt_s
        self._loads, self._weight_kg = loads, weight_kg
        self._matrix, self._map = drive.matrix(), static_map

    def begin(self, before_pa: Array) -> tuple[Array, Array]:
        """Tip and velocity (3,) [m, m/s] after pressures before_pa (k, N) every `dt_s`, from rest under the first."""
        tips = self._tips(before_pa, np.empty((0, self._matrix.shape[0])), len(before_pa))
        if len(tips) < 3:
            return tips[-1], np.zeros(3)
        return tips[-1], (1.5 * tips[-1] - 2 * tips[-2] + 0.5 * tips[-3]) / self._dt_s

    def follow(
        self, target_m: Array, coordinates: tuple[int, ...], before_pa: Array, enough_m: float = 0.0
    ) -> PathFollowing:
        """Pressures for targets (n, 3) [m] in some coordinates, from the last of before_pa (k, N) on.

        Gauss-Newton over all samples of a window: first statics on a coarse grid, then the dynamic model, whose error
        is mapped to pressures by the static gradients and the arm's second-order response. With `enough_m` the largest
        error counts instead of the root mean square, and it ends when that is at most `enough_m`.

        Raises:
            NotConverged: the arm has no equilibrium to start from.
            StepError: a quadratic programme was not solved.
        """
        axes = list(coordinates)
        start = self._drive.of_actuators(before_pa[-1])
        guess = np.maximum(start, GUESS * self._drive.highest_pa)
        motion = Dynamics(self._arm, self._dt_s)
        first_tip = motion.start(before_pa[0], self._loads).tip_m
        if len(before_pa) > 1:
            first_tip = motion.run(before_pa[1:]).tip_m[-1]
        pressure, tips = np.empty((len(target_m), self._drive.valves)), np.empty((len(target_m), 3))
        pressure[0], tips[0] = start, first_tip
        at = PathPlace(motion, motion.saved(), tips[0], pressure[0], pressure[:0])
        for first, stop, last in self._windows(len(target_m)):
            found, at = self._window(at, target_m[first : last + 1, axes], axes, guess, stop - first, enough_m)
            pressure[first + 1 : stop + 1], tips[first + 1 : stop + 1] = found.pressure_pa[1:], found.tip_m[1:]
        return PathFollowing(pressure, tips)

    def _windows(self, count: int) -> Iterator[tuple[int, int, int]]:
        """Rows of a path (count,) between which each window lies, and the last row that is solved with it."""
        length = max(1, round(WINDOW_S / self._dt_s))
        ahead = round((AHEAD_S + self._drive.highest_pa / self._drive.rate_pa_s) / self._dt_s)
        first = 0
        while first < count - 1:
            stop = first + length if first + length + ahead < count else count - 1
            yield first, stop, min(stop + ahead, count - 1)
            first = stop

    def _window(
        self, at: PathPlace, target: Array, axes: list[int], guess: Array, keep: int, enough_m: float
    ) -> tuple[PathFollowing, PathPlace]:
        """The first `keep` rows after a place that lead along targets (w, C), and the place after them."""
        pressure, gradient = self._static(target, axes, at.pressure_pa, guess)
        if known := len(at.ahead_pa):
            # At rest the pressures are others: without what is known there would be a jump.
            pressure[1 : known + 1] += np.linspace(1.0, 0.0, known)[:, None] * (at.ahead_pa - pressure[1 : known + 1])
            pressure = limited_step(gradient, np.zeros_like(target), pressure, self._drive, self._dt_s)
        response = self._response(pressure.mean(axis=0), axes)
        best: tuple[Array, Array, SavedMotion] | None = None
        least = np.inf
        for _ in range(DYNAMIC_STEPS):
            at.motion.restore(at.saved)
            rows = pressure[1:] @ self._matrix.T
            kept = at.motion.run(rows[:keep]).tip_m
            saved = at.motion.saved()
            tips = np.vstack([at.tip_m, kept, at.motion.run(rows[keep:]).tip_m])
            error = target - tips[:, axes]
            worst = float(np.linalg.norm(error, axis=1).max())
            size = worst if enough_m else float(np.sqrt(np.mean(error[np.isfinite(error)] ** 2)))
            improved = size < LEAST_PROGRESS * least
            if size < least or best is None:
                best, least = (pressure, tips, saved), size
            if not improved or size < SMALL_M or worst <= enough_m:
                break
            shift = self._correction(np.nan_to_num(error), response)
            pressure = limited_step(gradient, shift, pressure, self._drive, self._dt_s)
        assert best is not None
        pressure, tips, saved = best
        place = PathPlace(at.motion, saved, tips[keep], pressure[keep], pressure[keep + 1 :])
        return PathFollowing(pressure[: keep + 1], tips[: keep + 1]), place

    def _correction(self, error: Array, response: SecondOrderResponse) -> Array:
        smooth = gaussian_filter1d(error, SMOOTHING_S / self._dt_s, axis=0, mode="nearest")
        rate = np.gradient(smooth, self._dt_s, axis=0)
        acceleration = np.gradient(rate, self._dt_s, axis=0)
        found: Array = smooth + response.lag_s * rate + response.inertia_s2 * acceleration
        return found

    def _static(self, target: Array, axes: list[int], start: Array, guess: Array) -> tuple[Array, Array]:
        """Pressures (n, V) at rest on the path from `start` (V,) on, and the tip's gradients (n, C, V) by them."""
        n = len(target)
        stride = max(1, round(COARSE_S / self._dt_s))
        rows = np.unique(np.r_[np.arange(0, n, stride), n - 1])
        step_s = stride * self._dt_s
        coarse = np.vstack([start, np.tile(guess, (len(rows) - 1, 1))])
        tips, gradient = self._gradients(coarse, axes)
        error, before = target[rows] - tips, np.inf
        for _ in range(STATIC_STEPS):
            size = float(np.abs(error).max())
            if size < STATIC_ENOUGH_M or size > LEAST_PROGRESS * before:
                break
            before = size
            coarse = limited_step(gradient, error, coarse, self._drive, step_s)
            tips, gradient = self._gradients(coarse, axes)
            error = target[rows] - tips
        places = np.arange(n)
        pressure = _interpolated(places, rows, coarse)
        return pressure, _interpolated(places, rows, gradient)

    def _gradients(self, pressure: Array, axes: list[int]) -> tuple[Array, Array]:
        if self._map is not None:
            mapped, slopes = self._map.combined_slopes(pressure, self._map.payload_terms(0.0)[0])
            return mapped[:, axes], slopes[:, axes]
        rows = pressure @ self._matrix.T
        changes = [
            Variation(GRADIENT_STEP_PA, self._arm, rows + GRADIENT_STEP_PA * column) for column in self._matrix.T
        ]
        weights = np.full(len(rows), self._weight_kg) if self._weight_kg else None
        found = sensitivities.statics(self._arm, rows, changes, weights)
        tips, gradient = found.tip_m[:, axes], found.tip_by[:, axes]
        if not found.ok.all():
            good = np.flatnonzero(found.ok)
            if not len(good):
                raise ArithmeticError("the arm has no stable equilibrium along the path")
            nearest = good[np.argmin(np.abs(np.arange(len(rows))[:, None] - good), axis=1)]
            tips, gradient = tips[nearest], gradient[nearest]
        return tips, gradient

    def _response(self, pressure: Array, axes: list[int]) -> SecondOrderResponse:
        """Lag and inertia by least squares over the responses to a step of each valve's pressure."""
        count = max(12, round(RESPONSE_S / self._dt_s))
        rest = pressure[None] @ self._matrix.T
        left, right = [], []
        step_pa = min(RESPONSE_STEP_PA, 0.02 * self._drive.highest_pa)
        for column in self._matrix.T:
            stepped = rest + step_pa * column
            tips = self._tips(rest, np.repeat(stepped, count, axis=0), 1)[:, axes]
            settled = self._rest(stepped[0])[axes]
            rate = (tips[2:] - tips[:-2]) / (2 * self._dt_s)
            acceleration = (tips[2:] - 2 * tips[1:-1] + tips[:-2]) / self._dt_s**2
            left.append(np.column_stack([rate[1:].ravel(), acceleration[1:].ravel()]))
            right.append((settled - tips[2:-1]).ravel())
        lag, inertia = np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)[0]
        return SecondOrderResponse(max(float(lag), 0.0), max(float(inertia), 0.0))

    def _rest(self, pressure_pa: Array) -> Array:
        dynamics = Dynamics(self._arm, self._dt_s)
        return np.array(dynamics.start(pressure_pa, self._loads).tip_m)

    def _tips(self, before_pa: Array, pressure_pa: Array, last: int) -> Array:
        """Tips (last + n, 3) at the last rows of before_pa (k, N) and then under pressure_pa (n, N)."""
        dynamics = Dynamics(self._arm, self._dt_s)
        first = dynamics.start(before_pa[0], self._loads).tip_m
        rows = np.vstack([before_pa[1:], pressure_pa])
        found = np.vstack([first, dynamics.run(rows).tip_m if len(rows) else np.empty((0, 3))])
        return found[len(before_pa) - last :]


def _interpolated(places: NDArray[np.int64], rows: NDArray[np.int64], values: Array) -> Array:
    """Values (r, ..) at rows (r,), interpolated linearly at places (n,)."""
    left = np.clip(np.searchsorted(rows, places, side="right") - 1, 0, len(rows) - 2)
    share = (places - rows[left]) / (rows[left + 1] - rows[left])
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    found: Array = values[left] + share * (values[left + 1] - values[left])
    return found
