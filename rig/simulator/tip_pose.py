"""The pose of the simulated tip, which the scene reads from the plant."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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
