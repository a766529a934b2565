"""The cross-section: its stiffness, and the wrench of the pressures.

The section moves as a plane. The wall of actuator i at (x, y) is stretched by v3 - 1 + y u1 - x u2 (from eqs 8 and 13)
and sheared by (v1 - y u3, v2 + x u3). It carries an axial force k_i (stretch - a P_i) and shear forces gamma k_i times
the shear, with k_i = E_i A_m; about its own axis it resists bending by E_i I_o and torsion by 2 gamma E_i I_o. Summed
over the actuators, strains and wrench couple in two blocks: (v3, u1, u2) with (n3, m1, m2), and (v1, v2, u3) with
(n1, n2, m3). About the stiffness-weighted centre, which is the paper's neutral axis, the blocks become eqs 16, 20, 21.

Pressure acts twice: it pushes the caps, P_i A_in at each actuator, and its radial part stretches the wall freely by
a P_i (RPE, 4.4). Both are eigenstrains: constant wrenches by which the total wrench is less than that of the walls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.geometry import Geometry
from model.units import PA_PER_BAR


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
    """Derivatives of the stretch of each actuator by (v3, u1, u2): rows [1, y, -x], (N, 3)."""
    rows = np.ones((len(xy_m), 3))
    rows[:, 1], rows[:, 2] = xy_m[:, 1], -xy_m[:, 0]
    return rows


def section(
    geometry: Geometry,
    xy_m: Array,
    stiffness_n: Array,
    shear_ratio: float,
    rpe_per_bar: float,
) -> CrossSection:
    """The section whose actuators stand at xy_m (N, 2) and have axial stiffness E_i A_m = stiffness_n (N,) [N]."""
    rows = axial_rows(xy_m)
    spread = geometry.wall_second_moment_m4 / geometry.wall_area_m2
    weighted = (rows * stiffness_n[:, None]).T
    axial = weighted @ rows
    own = spread * stiffness_n.sum()
    axial[1, 1] += own
    axial[2, 2] += own
    x, y = xy_m.T
    side = shear_ratio * stiffness_n
    total, by_x, by_y = side.sum(), (side * x).sum(), (side * y).sum()
    torsion = (side * (x * x + y * y + 2 * spread)).sum()
    shear = np.array([[total, 0.0, -by_y], [0.0, total, by_x], [-by_y, by_x, torsion]])
    rest = np.zeros(6)
    rest[2:5] = -axial[:, 0]
    per_pressure = np.zeros((6, len(xy_m)))
    per_pressure[2:5] = -geometry.chamber_area_m2 * rows.T
    free = rpe_per_bar / PA_PER_BAR
    per_pressure[2:5] -= free * weighted
    return CrossSection(axial, shear, rest, per_pressure)


def upper(block: NDArray[Any]) -> list[Any]:
    """The six numbers of a symmetric 3 x 3 block, row by row."""
    return [block[i, j] for i in range(3) for j in range(i, 3)]
