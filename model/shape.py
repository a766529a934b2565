"""The shape of a solved arm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array

_SMALLEST = 1e-12
_UNIT = np.eye(3)


@dataclass(frozen=True)
class Shape:
    """The arm's axis at n points, in the base frame (z along the straight arm).

    s_m (n,): arc length at rest; the two ends of a coupling are two points. p_m (n, 3): position. rotation (n, 3, 3):
    section frame to base frame. v (n, 3): shear and stretch. u (n, 3) [1/m]: curvature and twist, both in the section
    frame. ok: False for the last good shape in place of one that could not be solved. stable: whether an arm at rest is
    at a minimum of its potential energy; None if this is not decided, as in motion.
    """

    s_m: Array
    p_m: Array
    rotation: Array
    v: Array
    u: Array
    ok: bool
    actuator_xy_m: Array = field(repr=False)
    stable: bool | None = None
    first_nodes: tuple[int, ...] = field(default=(), repr=False)
    """First point of each segment, then n; empty for one segment."""
    chambers: tuple[int, ...] = field(default=(), repr=False)
    """First actuator of each segment, then N; empty for one segment."""

    @property
    def tip_m(self) -> Array:
        """The end of the axis (3,) [m]."""
        tip: Array = self.p_m[-1]
        return tip

    @property
    def tip_rotation(self) -> Array:
        """Tip frame to base frame (3, 3)."""
        turned: Array = self.rotation[-1]
        return turned

    def frames_at(self, s_m: Array) -> tuple[Array, Array]:
        """Position (k, 3) [m] and rotation (k, 3, 3) of the sections at arc lengths (k,), between the points.

        Cubic Hermite interpolation of the axis, which is straight along a coupling; rotations by linear interpolation
        and Newton's iteration to the nearest rotation.
        """
        after = np.clip(np.searchsorted(self.s_m, s_m), 1, len(self.s_m) - 1)
        before, step = after - 1, self.s_m[after] - self.s_m[after - 1]
        t = ((s_m - self.s_m[before]) / step)[:, None]
        slope = np.einsum("nij,nj->ni", self.rotation, self.v)
        first, last = slope[before] * step[:, None], slope[after] * step[:, None]
        change = self.p_m[after] - self.p_m[before]
        if len(self.first_nodes) > 2:
            rigid = np.isin(after, self.first_nodes[1:-1])
            first[rigid], last[rigid] = change[rigid], change[rigid]
        position = self.p_m[before] + t * (
            first + t * (3 * change - 2 * first - last + t * (first + last - 2 * change))
        )
        rotation = (1 - t)[:, :, None] * self.rotation[before] + t[:, :, None] * self.rotation[after]
        while True:
            defect = np.swapaxes(rotation, 1, 2) @ rotation - _UNIT
            if np.abs(defect).max(initial=0.0) < _SMALLEST:
                return position, rotation
            rotation = rotation - 0.5 * rotation @ defect

    @property
    def actuator_points(self) -> NDArray[np.int64]:
        """The points (N, 2) of each actuator: its first, and the one after its last."""
        nodes = self.first_nodes or (0, len(self.s_m))
        chambers = self.chambers or (0, len(self.actuator_xy_m))
        return np.repeat(np.stack([nodes[:-1], nodes[1:]], axis=1), np.diff(chambers), axis=0)

    @property
    def actuator_lengths_m(self) -> Array:
        """Length (N,) [m] of each actuator's axis, from end to end of its segment."""
        nodes = self.first_nodes or (0, len(self.s_m))
        chambers = self.chambers or (0, len(self.actuator_xy_m))
        lengths = []
        for begin, end, first, last in zip(nodes, nodes[1:], chambers, chambers[1:], strict=False):
            x, y = self.actuator_xy_m[first:last].T
            v1, v2, v3 = self.v[begin:end].T[:, :, None]
            u1, u2, u3 = self.u[begin:end].T[:, :, None]
            speed = np.sqrt((v1 - u3 * y) ** 2 + (v2 + u3 * x) ** 2 + (v3 + u1 * y - u2 * x) ** 2)
            lengths.append(0.5 * np.diff(self.s_m[begin:end]) @ (speed[1:] + speed[:-1]))
        found: Array = np.concatenate(lengths)
        return found
