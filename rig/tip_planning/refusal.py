"""Why a rig cannot follow a tip path: where first, which limit binds, and what would be possible."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from model.inverse.reachable import ReachablePoint, nearest_reachable
from protocols.tip_inverse import TipRefusedError, TipRequest
from rig.config.sections import PA_PER_BAR
from rig.tip_planning.path_follower import PathFollower, TimedFollowing

Array = NDArray[np.float64]

MM = 1e3
SMALLEST = 0.1
"""Smallest share of speed and size that is tried."""
HALVINGS = 6
LEAD_IN_FELT_S = 0.5
"""How far into the path a lead-in that is too short has an effect."""
BINDING_S = 0.15
"""How far from the first excess a limit counts as its cause."""
AT_LIMIT_PA = 20.0


def refusal(follower: PathFollower, request: TipRequest, found: TimedFollowing) -> TipRefusedError:
    """The refusal of a path whose solution leaves the tolerance."""
    off_path = ~(found.error_m <= request.tolerance_m)
    on_path = off_path & (found.times_s >= 0)
    # The way to a point out of reach leads out of reach, too: the point of the path says more.
    first = int(np.argmax(on_path if on_path.any() else off_path))
    nearest = _nearest(follower, request, found.target_m[first])
    out_of_reach = nearest.distance_m > request.tolerance_m
    if not out_of_reach and not (on_path & (found.times_s >= LEAD_IN_FELT_S)).any():
        first = int(np.argmax(off_path))
        nearest = _nearest(follower, request, found.target_m[first])
    t_s = float(found.times_s[first])
    target = found.target_m[first]
    at_s = request.begin_s + request.lead_in_s + t_s
    where = "in the lead-in" if t_s < 0 else f"{t_s:.2f} s into the path"
    off = MM * float(found.error_m[first])
    text = f"{_point(target, request.coordinates)} at {at_s:.2f} s ({where}); the model's tip is {off:.2f} mm off"
    cause = _out_of_reach(follower, nearest) if out_of_reach else _too_fast(follower, found, first)
    expected = f"a path that the arm follows within {MM * request.tolerance_m:g} mm; {cause}; "
    if out_of_reach:
        place = _point(nearest.tip_m, request.coordinates)
        expected += f"the nearest reachable point is {place}, {MM * nearest.distance_m:.2f} mm away"
    else:
        expected += "at rest the arm reaches the point"
    return TipRefusedError(text, f"{expected}; {_remedies(follower, request, t_s, out_of_reach)}")


def _nearest(follower: PathFollower, request: TipRequest, target_m: Array) -> ReachablePoint:
    return nearest_reachable(follower.arm, follower.drive, target_m, request.coordinates, request.weight_kg)


def _remedies(follower: PathFollower, request: TipRequest, t_s: float, out_of_reach: bool) -> str:
    if t_s < 0 and not out_of_reach:
        return "a longer lead_in_s may do"
    found = []
    speed = 0.0 if out_of_reach else _largest(lambda share: follower.feasible(request, share, 1.0))
    if speed:
        period = request.path.period_s
        means = f" (period_s: {period / speed:.3g})" if period else ""
        found.append(f"{speed:.2f} of this speed{means}")
    size = _largest(lambda share: follower.feasible(request, 1.0, share))
    if size:
        found.append(f"{size:.2f} of this size about {_point(request.path.centre_m(), request.coordinates)}")
    if not found:
        return f"neither {SMALLEST:g} of its speed nor {SMALLEST:g} of its size makes it possible"
    return f"largest possible: {', or '.join(found)}"


def _largest(feasible: Callable[[float], bool]) -> float:
    """The largest share below 1 that is feasible, by bisection, rounded down; 0 if there is none."""
    low, high = SMALLEST, 1.0
    if not feasible(low):
        return 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if feasible(middle) else (low, middle)
    return math.floor(100 * low) / 100


def _out_of_reach(follower: PathFollower, nearest: ReachablePoint) -> str:
    binding = [
        _valve(follower, valve, f"at {pressure / PA_PER_BAR:.3g} bar")
        for valve, pressure in enumerate(nearest.pressure_pa)
        if pressure < AT_LIMIT_PA or pressure > follower.drive.highest_pa - AT_LIMIT_PA
    ]
    return f"the arm does not reach it: {', '.join(binding) or 'no pressure moves it closer'}"


def _too_fast(follower: PathFollower, found: TimedFollowing, first: int) -> str:
    dt_s = float(found.times_s[1] - found.times_s[0])
    near = max(1, round(BINDING_S / dt_s))
    part = found.following.pressure_pa[max(0, first - near) : first + near]
    rate = np.abs(np.diff(part, axis=0)).max(axis=0) / dt_s
    binding = [
        _valve(follower, valve, f"at {follower.config.limits.rate_bar_per_s:g} bar/s")
        for valve in range(follower.drive.valves)
        if rate[valve] > 0.99 * follower.drive.rate_pa_s
    ]
    for valve in range(follower.drive.valves):
        level = part[:, valve]
        if level.min() < AT_LIMIT_PA:
            binding.append(_valve(follower, valve, "at 0 bar"))
        if level.max() > follower.drive.highest_pa - AT_LIMIT_PA:
            binding.append(_valve(follower, valve, f"at {follower.drive.highest_pa / PA_PER_BAR:g} bar"))
    return f"too fast for {', '.join(binding)}" if binding else "its corners are too sharp for the arm at this speed"


def _valve(follower: PathFollower, valve: int, where: str) -> str:
    actuators = " and ".join(str(actuator + 1) for actuator in follower.drive.actuators[valve])
    return f"actuator{'s' if ' ' in actuators else ''} {actuators} {where}"


def _point(point_m: Array, coordinates: tuple[int, ...]) -> str:
    numbers = ", ".join(f"{'xyz'[axis]} {MM * point_m[axis]:.2f}" for axis in coordinates)
    return f"({numbers}) mm"
