"""The inverse solution of a rig: feed-forward set-points of a tip path, or the reasons why there is none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from model.arrays import Array
from model.inverse.reachable import ReachablePoint, nearest_reachable
from model.units import MM_PER_M, PA_PER_BAR
from protocols.tip_inverse import TipRefusedError, TipRequest, TipSolution
from protocols.tip_paths import TipPath, length_m
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.tip_planning.path_follower import NO_SOLUTION, PathFollower, PathSolution, solved_s

SMALLEST = 0.1
"""Smallest share of speed and size that is tried."""
RESOLUTION = 0.02
"""A share that is stated is possible, and one that is larger by this is not."""
LEAD_IN_FELT_S = 0.5
"""How far into the path a lead-in that is too short has an effect."""
BINDING_S = 0.15
"""How far from the first excess a limit counts as its cause."""
AT_LIMIT_PA = 20.0
SHORTEST_LEAD_IN_S = 0.2
USUAL_LEAD_IN_S = 3.0
"""Lead-in that is proposed, and with which speed and size are sought for a path that it does not make possible."""
METRES_M, METRES_SAMPLES = 1e-3, 50
"""No arm has its tip so close to its base: a path all within this is given in metres."""


class RigTipInverse:
    """The `TipInverse` of a rig with its model."""

    def __init__(self, config: RigConfig, variant: Variant | None = None) -> None:
        self._follower = PathFollower(config, variant)

    def solve(self, request: TipRequest) -> TipSolution:
        """The feed-forward set-points of a path.

        Raises:
            TipRefusedError: the path cannot be followed within its tolerance and the limits.
        """
        valves = self._follower.drive.valves
        if len(request.coordinates) > valves:
            axes = ", ".join("xyz"[axis] for axis in request.coordinates)
            rig = self._follower.config.name
            raise TipRefusedError(
                f"the coordinates {axes}",
                f"at most {valves}, because rig {rig} has {valves} valve{'s' if valves > 1 else ''}: "
                "give the step `coordinates`, or use a rig with more valves, such as mock-3",
            )
        path = request.path
        try:
            found = self._follower.solution(request, path)
        except NO_SOLUTION as error:
            raise TipRefusedError("a path without a solution", f"a path within the arm's reach: {error}") from None
        if not self._follower.within(request, found):
            raise infeasible_path_error(self._follower, request, found)
        times, pressure, tips = found.times_s, found.following.pressure_pa, found.following.tip_m
        if (solved := solved_s(path)) < path.duration_s:
            times, pressure, tips = _repeated(times, pressure, tips, path, solved)
        lead_s = -times[0]
        # The grid rounds the lead-in to whole steps.
        times = np.where(times < 0, times * (request.lead_in_s / lead_s if lead_s else 1.0), times)
        return TipSolution(times + request.lead_in_s, pressure @ self._follower.drive.matrix().T, tips, found.start)


def _repeated(times: Array, pressure: Array, tips: Array, path: TipPath, solved: float) -> tuple[Array, Array, Array]:
    """Continue the solution of the first part of a path by its last but one period."""
    assert path.period_s is not None
    rest_s = path.duration_s - (solved - path.period_s)
    dt_s = float(times[-1] - times[-2])
    once = round(path.period_s / dt_s)
    stop = len(times) - once
    count = math.ceil(rest_s / dt_s - 1e-9)
    rows = stop - once + np.arange(count) % once
    later = times[stop - 1] + dt_s * np.arange(1, count + 1)
    return (
        np.r_[times[:stop], later],
        np.vstack([pressure[:stop], pressure[rows]]),
        np.vstack([tips[:stop], tips[rows]]),
    )


def infeasible_path_error(follower: PathFollower, request: TipRequest, found: PathSolution) -> TipRefusedError:
    """The error for a path whose solution leaves the tolerance."""
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
    off = MM_PER_M * float(found.error_m[first])
    text = f"{_point(target, request.coordinates)} at {at_s:.2f} s ({where}); the model's tip is {off:.2f} mm off"
    cause = _out_of_reach(follower, nearest) if out_of_reach else _too_fast(follower, found, first)
    expected = f"a path that the arm follows within {MM_PER_M * request.tolerance_m:g} mm; {cause}; "
    if out_of_reach:
        place = _point(nearest.tip_m, request.coordinates)
        expected += f"the nearest reachable point is {place}, {MM_PER_M * nearest.distance_m:.2f} mm away"
    else:
        expected += "at rest the arm reaches the point"
        if farther := _farther_on(follower, request, found):
            out_of_reach, expected = True, f"{expected}, {farther}"
    return TipRefusedError(text, f"{expected}; {_remedies(follower, request, t_s, out_of_reach)}")


def _farther_on(follower: PathFollower, request: TipRequest, found: PathSolution) -> str:
    """The point of the path that is missed most, if the arm does not reach it; no speed makes such a path possible."""
    on_path = found.times_s >= 0
    worst = int(np.argmax(np.where(on_path, np.nan_to_num(found.error_m), -1.0)))
    target = found.target_m[worst]
    nearest = _nearest(follower, request, target)
    if nearest.distance_m <= request.tolerance_m:
        return ""
    at_s = request.begin_s + request.lead_in_s + float(found.times_s[worst])
    point, place = (_point(tip_m, request.coordinates) for tip_m in (target, nearest.tip_m))
    return f"but not {point} at {at_s:.2f} s: there the nearest is {place}, {MM_PER_M * nearest.distance_m:.2f} mm away"


def _nearest(follower: PathFollower, request: TipRequest, target_m: Array) -> ReachablePoint:
    return nearest_reachable(follower.arm, follower.drive, target_m, request.coordinates, request.weight_kg)


def _remedies(follower: PathFollower, request: TipRequest, t_s: float, out_of_reach: bool) -> str:
    if out_of_reach and _in_metres(request.path):
        return "are these metres? this step has mm"
    still = length_m(request.path) == 0
    if out_of_reach and still:
        return "give a point within its reach"
    neither = f"neither {SMALLEST:g} of its speed nor {SMALLEST:g} of its size makes it possible"
    # Almost no lead-in shows as a missed start of the path.
    in_lead_in = t_s < (LEAD_IN_FELT_S if request.lead_in_s < SHORTEST_LEAD_IN_S else 0.0)
    if out_of_reach or not (in_lead_in or still):
        if possible := _possible(follower, request, out_of_reach):
            return f"largest possible: {possible}"
        if out_of_reach or request.lead_in_s >= USUAL_LEAD_IN_S:
            return neither
    longer = ""
    if request.lead_in_s < USUAL_LEAD_IN_S:
        request = replace(request, lead_in_s=USUAL_LEAD_IN_S)
        if follower.accepts(request):
            return f"a lead_in_s of {USUAL_LEAD_IN_S:g} is long enough"
        longer = f" with a lead_in_s of {USUAL_LEAD_IN_S:g}"
    if still:
        return f"a lead_in_s of {request.lead_in_s:g} is not long enough either"
    if possible := _possible(follower, request, out_of_reach):
        return f"largest possible{longer}: {possible}"
    return f"{longer} {neither}".strip()


def _possible(follower: PathFollower, request: TipRequest, out_of_reach: bool) -> str:
    """Largest speed and size with which a path can be followed that cannot be at full speed and size; else empty."""
    found = []
    speed = 0.0 if out_of_reach else largest_share(lambda share: follower.accepts(request, share, 1.0))
    if speed:
        period = request.path.period_s
        means = f" (period_s: {_rounded_up(period / speed):g})" if period else ""
        found.append(f"{speed:.2f} of this speed{means}")
    if size := largest_share(lambda share: follower.accepts(request, 1.0, share)):
        about = _point(request.path.centre_m(), request.coordinates)
        found.append(f"{size:.2f} of this size in the same time about {about}")
    return ", or ".join(found)


def _rounded_up(period_s: float) -> float:
    """A period [s] with three digits, none faster than it is."""
    digit = 10.0 ** (math.floor(math.log10(period_s)) - 2)
    return math.ceil(period_s / digit - 1e-9) * digit


def _in_metres(path: TipPath) -> bool:
    """Whether the whole path is so close to the rod base that its coordinates are in metres."""
    times = np.linspace(0.0, path.duration_s, METRES_SAMPLES)
    return bool((np.abs(path.positions_m(times)) < METRES_M).all())


def largest_share(accepts: Callable[[float], bool]) -> float:
    """The largest share below 1 that is accepted, to RESOLUTION, by bisection; 0 if SMALLEST is not."""
    smallest = low = round(100 * SMALLEST)
    high = 100
    while high - low > 100 * RESOLUTION:
        percent = (low + high) // 2
        low, high = (percent, high) if accepts(percent / 100) else (low, percent)
    return low / 100 if low > smallest or accepts(SMALLEST) else 0.0


def _out_of_reach(follower: PathFollower, nearest: ReachablePoint) -> str:
    binding = [
        _valve(follower, valve, f"at {pressure / PA_PER_BAR:.3g} bar")
        for valve, pressure in enumerate(nearest.pressure_pa)
        if pressure < AT_LIMIT_PA or pressure > follower.drive.highest_pa - AT_LIMIT_PA
    ]
    return f"the arm does not reach it: {', '.join(binding) or 'no pressure moves it closer'}"


def _too_fast(follower: PathFollower, found: PathSolution, first: int) -> str:
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
    numbers = ", ".join(f"{'xyz'[axis]} {round(MM_PER_M * point_m[axis], 2) + 0.0:.2f}" for axis in coordinates)
    return f"({numbers}) mm"
