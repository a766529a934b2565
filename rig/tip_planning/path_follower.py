"""The pressures with which a rig's model follows a tip path as well as its limits allow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import model
from model import sensitivities
from model.arrays import Array
from model.inverse.drive import Drive
from model.inverse.path import PathFollowing, PathInverse
from model.inverse.static_map import MOST_VALVES, StaticMap
from model.units import PA_PER_BAR
from protocols.tip_inverse import HISTORY_S, HISTORY_STEP_S, TipRequest
from protocols.tip_paths import ScaledPath, TipPath, TipStart, fade
from rig.config.arm_model import TipLoad, model_arm
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from runs.interpolation import interpolated

STEP_S = 0.01
"""Longest time between two pressures of a solution."""
LONGEST_STEP_S, MOST_STEPS = 0.05, 30_000
"""The same in the search of a remedy for a long path, and its number of times above which they are farther apart."""
SETTLED_S = 1.5
"""Time after which a periodic path has periodic pressures."""
CORNERS_S = 60.0
"""Longest path of which the grid keeps the places of the corners; of a longer one some corner is anywhere."""
BETWEEN = (0.25, 0.382, 0.5, 0.618, 0.75)
"""Shares of a time step at which a path is compared with the tip, too: its corners lie between the times."""
NEAR = 1.5
"""Excess over the tolerance up to which the solution with the least rms error is tried, too."""
RATE_SHARE = 0.995
"""Share of the rate limit that a solution uses: its times are rounded."""
MAP_SAMPLES, MAP_ACCURACY_M = 50, 5e-5
"""How often a static map is compared with the rod, and how far it may be off."""
NO_SOLUTION = (ArithmeticError, model.NotConverged)


def drive_of(config: RigConfig) -> Drive:
    """The valves and the limits of a rig's pressures."""
    groups = tuple(tuple(actuator - 1 for actuator in valve.actuators) for valve in config.valves)
    limits = config.limits
    return Drive(groups, limits.pressure_bar * PA_PER_BAR, RATE_SHARE * limits.rate_bar_per_s * PA_PER_BAR)


def static_map_of(arm: model.Arm, drive: Drive, weight_kg: float) -> StaticMap | None:
    """The map of an arm with a weight, if it agrees with the rod at pressures drawn at random within the limit."""
    if drive.valves > MOST_VALVES:
        return None
    valve_of = np.argmax(drive.matrix(), axis=1)
    try:
        found = StaticMap.of(arm, tuple(valve_of.tolist()), drive.highest_pa, weight_kg, terms=1)
    except model.NotConverged:
        return None
    pressure = np.random.default_rng(0).uniform(0.0, drive.highest_pa, (MAP_SAMPLES, drive.valves))
    rod = sensitivities.statics(arm, pressure[:, valve_of], weight_kg=np.full(MAP_SAMPLES, weight_kg)).tip_m
    off_m = np.linalg.norm(found.tips(pressure) - rod, axis=1)
    return found if bool((off_m <= MAP_ACCURACY_M).all()) else None


@dataclass(frozen=True, eq=False)
class PathSolution:
    """A solution on its grid: times (n,) from the beginning of the path [s], targets (n, 3) [m], where it starts."""

    times_s: Array
    target_m: Array
    start: TipStart
    following: PathFollowing
    error_m: Array


class PathFollower:
    """Follows tip paths with the model of a rig, within the limits of its pressures."""

    def __init__(self, config: RigConfig, variant: Variant | None = None) -> None:
        self.config = config
        self.arm = model_arm(config, variant)
        self.drive = drive_of(config)
        self._loads = TipLoad(config)
        self._maps: dict[float, StaticMap | None] = {}

    def follow(self, request: TipRequest, path: TipPath, step_s: float = STEP_S, enough_m: float = 0.0) -> PathSolution:
        """The pressures of `path` for `solved_s`, within the tolerance or not, at times at most `step_s` apart.

        With `enough_m` it answers only whether the largest error can be at most that: it ends as soon as that is known.

        Raises:
            ArithmeticError, NotConverged: there is no solution.
        """
        dt_s, duration_s = _grid_step_s(path, step_s), solved_s(path)
        weight_kg = request.weight_kg
        inverse = PathInverse(
            self.arm, self.drive, dt_s, self._loads.carrying(weight_kg), weight_kg, self._static_map(weight_kg)
        )
        before = _resampled(request.before_pa, dt_s)
        position, velocity = inverse.begin(before)
        start = TipStart(position, velocity)
        lead = round(request.lead_in_s / dt_s)
        times: Array = np.arange(-lead, math.ceil(duration_s / dt_s - 1e-9) + 1.0) * dt_s
        target, _ = fade(start, path, lead * dt_s, times)
        following = inverse.follow(target, request.coordinates, before, enough_m)
        error = following.error_m(target, request.coordinates)
        between = _between_m(path, duration_s, times, following.tip_m, request.coordinates)
        return PathSolution(times, target, start, following, np.maximum(error, between))

    def _static_map(self, weight_kg: float) -> StaticMap | None:
        """The map of the arm with a weight; None where the rod itself has to be solved."""
        if weight_kg not in self._maps:
            self._maps[weight_kg] = static_map_of(self.arm, self.drive, weight_kg)
        return self._maps[weight_kg]

    def within(self, request: TipRequest, found: PathSolution) -> bool:
        """True if the tip of the model stays within the tolerance."""
        return bool(np.all(found.error_m <= request.tolerance_m))

    def solution(self, request: TipRequest, path: TipPath) -> PathSolution:
        """The pressures of `path` with the least rms error, or, if they leave the tolerance, others within it.

        Raises:
            ArithmeticError, NotConverged: there is no solution.
        """
        found = self.follow(request, path)
        if self.within(request, found):
            return found
        bounded = self.follow(request, path, enough_m=request.tolerance_m)
        return bounded if self.within(request, bounded) else found

    def accepts(self, request: TipRequest, speed: float = 1.0, size: float = 1.0) -> bool:
        """True if the path can be followed at this share of its speed and size; of a long one on a coarser grid."""
        path = ScaledPath(request.path, speed, size)
        step_s = min(max(STEP_S, solved_s(path) / MOST_STEPS), LONGEST_STEP_S)
        try:
            bounded = self.follow(request, path, step_s, enough_m=request.tolerance_m)
            near = float(bounded.error_m.max()) < NEAR * request.tolerance_m
            return self.within(request, bounded) or (near and self.within(request, self.follow(request, path, step_s)))
        except NO_SOLUTION:
            return False


def solved_s(path: TipPath) -> float:
    """How much of a path needs a solution [s]: of a periodic one the periods until the pressures are periodic.

    One period more than needed: at the end of a solution the pressures have no target after them.
    """
    if path.period_s is None:
        return path.duration_s
    return min(path.duration_s, (2 + math.ceil(SETTLED_S / path.period_s)) * path.period_s)


def _grid_step_s(path: TipPath, step_s: float) -> float:
    """The step of a grid, at most `step_s`, that divides the period of a path, or the whole path.

    How far a corner is missed depends on its place between two times. A path with corners has a power of two of steps:
    at most speeds a path that is slowed down has its corners at the same places.
    """
    whole = path.period_s or path.duration_s
    steps = max(1, math.ceil(whole / step_s - 1e-9))
    return whole / (2 ** math.ceil(math.log2(steps)) if path.has_corners and whole <= CORNERS_S else steps)


def _between_m(path: TipPath, duration_s: float, times_s: Array, tip_m: Array, coordinates: Sequence[int]) -> Array:
    """How far (n,) the tip is from a path until `duration_s` between each time of the grid and the next one, at most.

    Between the times the tip is interpolated (Catmull-Rom); a path may have a corner there.
    """
    out = np.zeros(len(times_s))
    on_path = np.flatnonzero((times_s[:-1] >= 0.0) & (times_s[1:] <= duration_s))
    axes = list(coordinates)
    at, step_s, tips = times_s[on_path], np.diff(times_s)[on_path], tip_m[:, axes]
    first, last = tips[on_path], tips[on_path + 1]
    before, after = tips[np.maximum(on_path - 1, 0)], tips[np.minimum(on_path + 2, len(tips) - 1)]
    for share in BETWEEN:
        rest = 1.0 - share
        bow = 0.5 * share * rest * (rest * (first - before + first - last) + share * (last - after + last - first))
        tip = rest * first + share * last + bow
        off = np.linalg.norm(path.positions_m(at + share * step_s)[:, axes] - tip, axis=1)
        out[on_path] = np.maximum(out[on_path], off)
    return out


def _resampled(before_pa: Array, dt_s: float) -> Array:
    """The set-points before a motion on another grid that ends at the same time."""
    given = -HISTORY_STEP_S * np.arange(len(before_pa) - 1, -1, -1)
    wanted = -dt_s * np.arange(max(2, round(HISTORY_S / dt_s)), -1, -1)
    return interpolated(wanted, given, before_pa)
