"""The cross-section: stiffness between strains and wall wrench, and what a pressure adds.

The section moves as a plane. The wall of actuator i at (x, y) is stretched by v3 - 1 + y u1 - x u2 (from eqs 8 and 13)
and sheared by (v1 - y u3, v2 + x u3). It carries an axial force k_i (stretch - a P_i) and shear forces gamma k_i times
the shear, with k_i = E_i A_m; about its own axis it resists bending by E_i I_o and torsion by 2 gamma E_i I_o. Summed
over the actuators, strains and wrench couple in two blocks: (v3, u1, u2) with (n3, m1, m2), and (v1, v2, u3) with
(n1, n2, m3). About the stiffness-weighted centre, which is the paper's neutral axis, the blocks become eqs 16, 20, 21.

Pressure enters twice: it pushes the caps, P_i A_in at each actuator, and its radial part stretches the wall freely by
a P_i (RPE, 4.4). Both are eigenstrains: constant wrenches that the total wrench lacks against the wall's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from model.actuation import PA_PER_BAR
from model.geometry import Geometry

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CrossSection:
    """Two 3 x 3 stiffness blocks and the wrench offsets of pressure, about the line through (0, 0) of `xy_m`.

    axial: over (v3, u1, u2) [N, N m, ..]. shear: over (v1, v2, u3). rest: wrench (6,) in the order n1 n2 n3 m1 m2 m3 at
    zero strain and zero pressure. per_pressure: wrench per pascal of each actuator (6, N).
    """

    axial: Array
    shear: Array
    rest: Array
    per_pressure: Array


def axial_rows(xy_m: Array) -> Array:
    """How (v3, u1, u2) stretch each actuator: rows [1, y, -x], (N, 3)."""
    return np.stack([np.ones(len(xy_m)), xy_m[:, 1], -xy_m[:, 0]], axis=1)


def section(
    geometry: Geometry,
    xy_m: Array,
    stiffness_n: Array,
    shear_ratio: float,
    rpe_per_bar: float,
    rpe_as: Literal["force", "strain"] = "force",
) -> CrossSection:
    """The section whose actuators stand at xy_m (N, 2) and have axial stiffness E_i A_m = stiffness_n (N,) [N].

    rpe_as: the RPE as a force on each tube, or as the plane through the tubes' free strains (4.4).
    """
    rows = axial_rows(xy_m)
    spread = geometry.wall_second_moment_m4 / geometry.wall_area_m2
    axial = (rows * stiffness_n[:, None]).T @ rows + np.diag([0.0, 1.0, 1.0]) * spread * stiffness_n.sum()
    x, y = xy_m.T
    side = shear_ratio * stiffness_n
    turn = float((side * (x**2 + y**2 + 2 * spread)).sum())
    pull_x, pull_y, total = float((side * x).sum()), float((side * y).sum()), float(side.sum())
    shear = np.array([[total, 0.0, -pull_y], [0.0, total, pull_x], [-pull_y, pull_x, turn]])
    rest = np.zeros(6)
    rest[2:5] = -axial[:, 0]
    per_pressure = np.zeros((6, len(xy_m)))
    per_pressure[2:5] = -geometry.chamber_area_m2 * rows.T
    free = rpe_per_bar / PA_PER_BAR
    # As a force, a tube's own bending stiffness resists the RPE; as a strain of the section, it takes part.
    per_pressure[2:5] -= free * ((rows * stiffness_n[:, None]).T if rpe_as == "force" else axial @ np.linalg.pinv(rows))
    return CrossSection(axial, shear, rest, per_pressure)


def upper(block: NDArray[Any]) -> list[Any]:
    """The six numbers of a symmetric 3 x 3 block, row by row."""
    return [block[i, j] for i in range(3) for j in range(i, 3)]
