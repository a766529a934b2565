"""Recent poses of the tip, and interpolation between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.simulator.tip_pose import TipPose

FURTHEST_AHEAD_NS = 20_000_000
"""Longest extrapolation beyond the newest entry; later times get the pose at that limit."""

_MOST_ITERATIONS = 50
_DEFECT = 1e-8
_UNIT = np.eye(3)

POSE_DTYPE = np.dtype(
    [("index", "<i8"), ("t_ns", "<i8"), ("position_m", "<f8", (3,)), ("rotation", "<f8", (3, 3))], align=True
)


def pose_among(entries: NDArray[np.void], t_ns: int) -> TipPose:
    """Interpolate the pose at a time from entries (n,) of POSE_DTYPE, oldest first, n at least 1.

    Before the first entry of all (index 0) the arm was at rest in it.

    Raises:
        LookupError: the time lies before the entries that are left.
    """
    times = entries["t_ns"]
    if t_ns < times[0]:
        if entries["index"][0] != 0:
            raise LookupError(f"the tip's pose of {(times[-1] - t_ns) * 1e-9:.2f} s ago is forgotten")
        return TipPose(t_ns, entries["position_m"][0].copy(), entries["rotation"][0].copy())
    if len(entries) == 1:
        return TipPose(t_ns, entries["position_m"][0].copy(), entries["rotation"][0].copy())
    after = min(max(int(np.searchsorted(times, t_ns)), 1), len(entries) - 1)
    a, b = entries[after - 1], entries[after]
    until = min(t_ns, int(times[-1]) + FURTHEST_AHEAD_NS)
    share = (until - int(a["t_ns"])) / (int(b["t_ns"]) - int(a["t_ns"]))
    position = a["position_m"] + share * (b["position_m"] - a["position_m"])
    return TipPose(t_ns, position, _nearest_rotation(a["rotation"] + share * (b["rotation"] - a["rotation"])))


def _nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation nearest to a mean of two that are less than half a turn apart, by Newton's iteration."""
    rotation = matrix
    for _ in range(_MOST_ITERATIONS):
        defect = rotation.T @ rotation - _UNIT
        rotation = rotation - 0.5 * rotation @ defect
        # The error after a step is about the square of the one before.
        if np.abs(defect).max() < _DEFECT:
            break
    return rotation
