"""Potential energy of an arm at rest and its smallest second variation, separate from the code of the model.

The arm is a chain of straight elements between cross-sections that may move and turn. Strains are those of the middle
of an element. Everything is written about the arm's axis, each tube at its own place.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.linalg import eig_banded
from scipy.spatial.transform import Rotation

from model import Arm, Loads, Shape
from model.arrays import Array
from model.laws.quadratic_compliance import QuadraticCompliance

UNKNOWNS = 12  # of an element: displacement and rotation of both its ends
SHIFT = np.tile([1e-5] * 3 + [1e-3] * 3, 2)  # [m], [rad]


def smallest_variation(arm: Arm, pressure_pa: Array, loads: Loads, shape: Shape) -> float:
    """Smallest eigenvalue [J] of the energy's Hessian; displacements count by the length of the arm."""
    count = len(shape.s_m) - 1
    blocks = _element_hessians(arm, pressure_pa, shape)
    blocks[-1, 6:, 6:] += _tip_hessian(arm, loads, shape)
    if arm.geometry.centroid_m.any():
        weights = _line_load(arm, loads)
        for j in range(count):
            for end, node in ((0, j), (6, j + 1)):
                share = 0.5 * (shape.s_m[j + 1] - shape.s_m[j])
                lever = np.array([*arm.geometry.centroid_m, 0.0])
                blocks[j, end + 3 : end + 6, end + 3 : end + 6] += _lever(shape.rotation[node], lever, share * weights)
    size = 6 * count
    band = np.zeros((UNKNOWNS, size))
    scale = np.array([arm.geometry.length_m] * 3 + [1.0] * 3)
    blocks *= np.tile(scale, 2)[:, None] * np.tile(scale, 2)
    for j in range(count):
        for r in range(UNKNOWNS):
            for c in range(r + 1):
                row, column = 6 * (j - 1) + r, 6 * (j - 1) + c
                if column >= 0:
                    band[row - column, column] += blocks[j, r, c]
    return float(eig_banded(band, lower=True, eigvals_only=True, select="i", select_range=(0, 0))[0])


def _element_hessians(arm: Arm, pressure_pa: Array, shape: Shape) -> Array:
    """Hessians (E, 12, 12) of the elements' energies, by central differences."""
    ends = shape.p_m[:-1], shape.rotation[:-1], shape.p_m[1:], shape.rotation[1:]
    steps = np.diff(shape.s_m)
    here = _strains(*ends, steps)
    wrench, tangent = _section(arm, pressure_pa, here)
    pairs = list(itertools.combinations_with_replacement(range(UNKNOWNS), 2))
    unit = np.diag(SHIFT)
    moved = np.array([a * unit[r] + b * unit[c] for a in (1, -1) for b in (1, -1) for r, c in pairs])

    near, far = (Rotation.from_rotvec(moved[:, at : at + 3]).as_matrix()[:, None] for at in (3, 9))
    strains = _strains(
        ends[0] + moved[:, None, :3], ends[1] @ near, ends[2] + moved[:, None, 6:9], ends[3] @ far, steps
    )
    more = strains - here
    # About the solution the energy of a section is known by its wrench and its tangent.
    energy = steps * (np.einsum("ei,mei->me", wrench, more) + 0.5 * np.einsum("mei,eij,mej->me", more, tangent, more))
    both, ahead, behind, back = energy.reshape(4, len(pairs), len(steps))
    hessian = np.empty((len(steps), UNKNOWNS, UNKNOWNS))
    for k, (r, c) in enumerate(pairs):
        second = (both[k] - ahead[k]) - (behind[k] - back[k])
        hessian[:, r, c] = hessian[:, c, r] = second / (4 * SHIFT[r] * SHIFT[c])
    return hessian


def _strains(p: Array, turned: Array, p_next: Array, turned_next: Array, steps: Array) -> Array:
    """Strains v, u (.., 6) of elements between cross-sections at p (.., 3), turned (.., 3, 3)."""
    across = np.swapaxes(turned, -1, -2) @ turned_next
    between = Rotation.from_matrix(across.reshape(-1, 3, 3)).as_rotvec()
    half = Rotation.from_rotvec(0.5 * between).as_matrix().reshape(across.shape)
    v = np.einsum("...ij,...i->...j", turned @ half, p_next - p)
    return np.concatenate([v, between.reshape(v.shape)], axis=-1) / steps[:, None]


def wrench_of(arm: Arm, pressure_pa: Array, strains: Array) -> Array:
    """Total wrenches (E, 6) of sections with strains v, u (E, 6), tube by tube."""
    geometry, material = arm.geometry, arm.material
    v1, v2, v3, u1, u2, u3 = strains.T
    slender = geometry.wall_second_moment_m4 / geometry.wall_area_m2
    wrench = np.zeros(strains.shape)
    for (x, y), pressed in zip(geometry.positions_m, pressure_pa, strict=True):
        strain, k = v3 - 1 + y * u1 - x * u2 - arm.rpe_per_bar * pressed / 1e5, np.full(len(v3), arm.stiffness_n)
        pull = k * strain
        if isinstance(arm.law, QuadraticCompliance):
            a1, a2 = material.a1_per_n, material.a2_per_n2
            pull = 2 * strain / (a1 + np.sqrt(a1 * a1 + 4 * a2 * abs(strain)))
            k = 2 / (a1 + np.sqrt(a1 * a1 + 4 * a2 * np.hypot(strain, 5e-3)))
        along, side = pull - pressed * geometry.chamber_area_m2, material.shear_ratio * k
        f1, f2 = side * (v1 - y * u3), side * (v2 + x * u3)
        bent = slender * k
        couple = [y * along + bent * u1, -x * along + bent * u2, x * f2 - y * f1 + 2 * slender * side * u3]
        wrench += np.stack([f1, f2, along, *couple], axis=1)
    return wrench


def _section(arm: Arm, pressure_pa: Array, strains: Array) -> tuple[Array, Array]:
    """Wrench (E, 6) and symmetric tangent (E, 6, 6) of sections with strains (E, 6)."""
    tangent = np.empty((len(strains), 6, 6))
    for c, step in enumerate([1e-6] * 3 + [1e-4] * 3):
        more = step * np.eye(6)[c]
        ahead, back = wrench_of(arm, pressure_pa, strains + more), wrench_of(arm, pressure_pa, strains - more)
        tangent[:, :, c] = (ahead - back) / (2 * step)
    return wrench_of(arm, pressure_pa, strains), 0.5 * (tangent + tangent.transpose(0, 2, 1))


def _line_load(arm: Arm, loads: Loads) -> Array:
    """Force per metre (3,), the same everywhere."""
    weight = arm.line_density_kg_m * arm.rod_weight * np.array(arm.gravity_m_s2)
    return np.asarray(loads.force_n_per_m) + weight


def _tip_hessian(arm: Arm, loads: Loads, shape: Shape) -> Array:
    out = np.zeros((6, 6))
    out[3:, 3:] = _lever(shape.rotation[-1], np.asarray(loads.tip_point_m), np.asarray(loads.tip_force_n))
    return out


def _lever(turned: Array, lever: Array, force: Array) -> Array:
    """Hessian by rotation of -force . R lever."""
    own = turned.T @ force
    return np.asarray((own @ lever) * np.eye(3) - 0.5 * (np.outer(own, lever) + np.outer(lever, own)))
