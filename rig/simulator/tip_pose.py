"""The pose of the simulated tip, which the scene reads from the plant: recent ones, and those between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FURTHEST_AHEAD_NS = 20_000_000
"""Longest extrapolation beyond the newest entry; later times get the pose at that limit."""

_MOST_ITERATIONS = 50
_DEFECT = 1e-8
_UNIT = np.eye(3)
# One object each: what is sent to another process holds it once.
_NO_POSITIONS, _NO_ROTATIONS = np.empty((0, 3)), np.empty((0, 3, 3))


@dataclass(frozen=True)
class TipPose:
    """The tip frame in the rod-base frame: a point x of the tip frame is `rotation` x + `position_m`.

    `section_m` (k, 3) and `section_rotation` (k, 3, 3) are those of the rig's measured sections.
    """

    t_ns: int
    position_m: NDArray[np.float64]
    rotation: NDArray[np.float64]
    section_m: NDArray[np.float64] = field(default_factory=lambda: _NO_POSITIONS)
    section_rotation: NDArray[np.float64] = field(default_factory=lambda: _NO_ROTATIONS)


class PoseSource(Protocol):
    """A source of recent tip poses."""

    def pose_at(self, t_ns: int) -> TipPose:
        """Return the pose at a time within the last second, interpolated."""


def pose_dtype(sections: int = 0) -> np.dtype[np.void]:
    """One pose of the tip and one of each measured section."""
    along = [("section_m", "<f8", (sections, 3)), ("section_rotation", "<f8", (sections, 3, 3))] if sections else []
    tip = [("index", "<i8"), ("t_ns", "<i8"), ("position_m", "<f8", (3,)), ("rotation", "<f8", (3, 3))]
    return np.dtype([*tip, *along], align=True)


def pose_among(entries: NDArray[np.void], t_ns: int) -> TipPose:
    """Interpolate the pose at a time from entries (n,) of `pose_dtype`, oldest first, n at least 1.

    Before the first entry of all (index 0) the arm was at rest in it.

    Raises:
        LookupError: the time lies before the entries that are left.
    """
    times = entries["t_ns"]
    if t_ns < times[0]:
        if entries["index"][0] != 0:
            raise LookupError(f"the tip's pose of {(times[-1] - t_ns) * 1e-9:.2f} s ago is forgotten")
        return _standing(t_ns, entries[0])
    if len(entries) == 1:
        return _standing(t_ns, entries[0])
    after = min(max(int(np.searchsorted(times, t_ns)), 1), len(entries) - 1)
    a, b = entries[after - 1], entries[after]
    until = min(t_ns, int(times[-1]) + FURTHEST_AHEAD_NS)
    share = (until - int(a["t_ns"])) / (int(b["t_ns"]) - int(a["t_ns"]))
    position = a["position_m"] + share * (b["position_m"] - a["position_m"])
    rotation = _nearest_rotation(a["rotation"] + share * (b["rotation"] - a["rotation"]))
    if not _has_sections(entries.dtype):
        return TipPose(t_ns, position, rotation)
    sections = a["section_m"] + share * (b["section_m"] - a["section_m"])
    turned = a["section_rotation"] + share * (b["section_rotation"] - a["section_rotation"])
    return TipPose(t_ns, position, rotation, sections, np.array([_nearest_rotation(matrix) for matrix in turned]))


def _standing(t_ns: int, entry: np.void) -> TipPose:
    tip = TipPose(t_ns, entry["position_m"].copy(), entry["rotation"].copy())
    if not _has_sections(entry.dtype):
        return tip
    return replace(tip, section_m=entry["section_m"].copy(), section_rotation=entry["section_rotation"].copy())


def _has_sections(dtype: np.dtype[np.void]) -> bool:
    return "section_m" in (dtype.names or ())


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
