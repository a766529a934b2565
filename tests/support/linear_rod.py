"""An arm at rest whose tubes have one modulus each, by SciPy: about the central axis, with the coupled section law."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

from model import Arm
from model.arrays import Array
from model.section import axial_rows, section

ORDER = [2, 3, 4, 0, 1, 5]
"""(v3, u1, u2) and (v1, v2, u3) among (v, u)."""


def linear_rod_tip(arm: Arm, pressure_pa: Array, stiffness_n: Array, rpe_as: str = "force") -> tuple[Array, Array]:
    """Position (3,) and rotation (3, 3) of the tip under pressures (N,), for axial stiffnesses (N,) of the tubes.

    rpe_as: the radial effect as a force on each tube, or as the plane through the free strains of all.
    """
    xy, length = arm.geometry.positions_m, arm.geometry.length_m
    rpe = arm.rpe_per_bar if rpe_as == "force" else 0.0
    law = section(arm.geometry, xy, stiffness_n, arm.material.shear_ratio, rpe)
    stiffness = np.zeros((6, 6))
    stiffness[np.ix_(ORDER[:3], ORDER[:3])], stiffness[np.ix_(ORDER[3:], ORDER[3:])] = law.axial, law.shear
    offset = law.rest + law.per_pressure @ pressure_pa
    if rpe_as == "strain":
        plane = np.linalg.lstsq(axial_rows(xy), arm.rpe_per_bar * pressure_pa / 1e5, rcond=None)[0]
        offset[2:5] -= law.axial @ plane
    weight = arm.cap_mass_kg * np.asarray(arm.gravity_m_s2)

    def slope(_: float, y: Array) -> Array:
        turned, n, m = y[3:12].reshape(3, 3), y[12:15], y[15:]
        strain = np.linalg.solve(stiffness, y[12:] - offset)
        v, u = strain[:3], strain[3:]
        hat = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        return np.concatenate([turned @ v, (turned @ hat).ravel(), -np.cross(u, n), -np.cross(u, m) - np.cross(v, n)])

    def end(base: Array) -> Array:
        start = np.concatenate([np.zeros(3), np.eye(3).ravel(), base])
        found: Array = solve_ivp(slope, (0, length), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        return found

    def gap(base: Array) -> Array:
        y = end(base)
        return np.concatenate([y[12:15] - y[3:12].reshape(3, 3).T @ weight, y[15:]])

    solved = end(root(gap, np.append(weight, np.zeros(3)), tol=1e-13).x)
    return solved[:3], solved[3:12].reshape(3, 3)
