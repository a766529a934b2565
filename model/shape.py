"""The solved rod: where the arm is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """The arm's axis at n points, in the base frame (z along the straight arm).

    s_m (n,): arc length at rest. p_m (n, 3): position. rotation (n, 3, 3): section frame to base frame. v (n, 3): shear
    and stretch. u (n, 3) [1/m]: curvature and twist, both in the section frame. ok: False when this is the last good
    shape because the asked one could not be solved. stable: whether an arm at rest is a minimum of its potential
    energy; None where this is not decided, as in motion.
    """

    s_m: Array
    p_m: Array
    rotation: Array
    v: Array
    u: Array
    ok: bool
    actuator_xy_m: Array = field(repr=False)
    stable: bool | None = None

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

    @property
    def actuator_lengths_m(self) -> Array:
        """Length (N,) [m] of each actuator's axis from cap to cap."""
        x, y = self.actuator_xy_m.T
        v1, v2, v3 = self.v.T[:, :, None]
        u1, u2, u3 = self.u.T[:, :, None]
        speed = np.sqrt((v1 - u3 * y) ** 2 + (v2 + u3 * x) ** 2 + (v3 + u1 * y - u2 * x) ** 2)
        lengths: Array = 0.5 * np.diff(self.s_m) @ (speed[1:] + speed[:-1])
        return lengths
