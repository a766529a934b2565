"""The inverse solution of a rig: feed-forward set-points of a tip path, or the reasons why there is none."""

from __future__ import annotations

import math

import numpy as np

from model.arrays import Array
from protocols.tip_inverse import TipRefusedError, TipRequest, TipSolution
from protocols.tip_paths import TipPath
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.tip_planning.infeasible_path import infeasible_path_error
from rig.tip_planning.path_follower import NO_SOLUTION, PathFollower, solved_s


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
