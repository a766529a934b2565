"""Arguments of the kernels.

At each call numba looks up every field of a NamedTuple by its name, but not the items of a plain tuple. So Python
passes plain tuples of these fields, and the kernel builds the NamedTuple from them. `Walls` is an argument of its own,
because numba reads its type from the object instead of from its fields.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from model.kernels.law import Walls

Array = Any
Fields = tuple[Any, ...]


class ArmArguments(NamedTuple):
    """One arm with N steps along it, from `model.kernel_arguments.KernelArguments`; many arms have a leading axis."""

    work: Array  # (size,), the lanes and the section, as of `layout`; written to
    stiffness: Array  # (R, 24), stiffness blocks and their inverses, for each row of pressures or one for all
    rest: Array  # (Q, 6), wrench at zero strain, likewise
    per_pressure: Array  # (R, 6, N), wrench per pascal, likewise
    free_per_pa: Array  # free strain of the radial pressure effect [1/Pa], one number or (B,)
    load: Array  # distributed load at nodes and mid-points, 2 N + 1 rows of 6, flat
    loaded: bool  # whether any load is not zero
    tip: Array  # (19,), load at the tip, in the order of `layout.TIP_LOAD`
    length: Array  # [m], one number or (B,)
    scale: Array  # (32,), magnitudes of the states for Newton's method, then their reciprocals
    centre: Array  # (2,) [m], centroid of the walls


class LaneArguments(NamedTuple):
    """Perturbed copies of an arm in W work arrays of eight lanes, as of `lanes.apply_pressure`."""

    works: Array  # (W, size); written to
    stiffness: Array  # (R, W, 24, 8)
    rest: Array  # (Q, W, 6, 8)
    per_pressure: Array  # (R, W, 6, N, 8)
    free_per_pa: Array  # (W, 8)
    cap_loads: Array  # (W, 19, 8), loads at the tip by the cap
    loaded: bool  # whether any lane has a distributed load
    cap_inertia: bool  # whether the cap has inertia
    branch_factors: Array  # (W, 1 + B, 3, 8), as of `MotionState`
    scale: Array  # (32,), as of `ArmArguments`


class MotionState(NamedTuple):
    """State of an arm in motion between two time steps; every array is written to."""

    last_pressures: Array  # (3, N) [Pa], of the last three time steps, the latest first
    segments: int  # number of shooting segments
    coefficients: Array  # (5,), c0, c1, c2, c3 and d1 of the time scheme (eq 26)
    past_states: Array  # (2, 2 N + 2, 16), solutions of the two time steps before the last
    x: Array  # (2 N + 2, 16), solution of the last time step: states at the nodes, then their derivatives
    branch_factors: Array  # (1 + B, 3), of the Maxwell branches of the walls, as of `relaxation.relax_branches`
    branch_strains: Array  # (B, 2 N + 2, 6)


class Rod(NamedTuple):
    """One rod and its loads: a boundary value problem, as kernels hand it to kernels."""

    work: Array  # (size,), as of `ArmArguments`; written to
    walls: Walls
    load: Array  # as of `ArmArguments`
    loaded: bool
    tip: Array  # (19,), load at the tip
    length: float  # [m]
    scale: Array  # (32,)


class PressureWrench(NamedTuple):
    """Wrench of the pressures in a section, and free strains; the stiffness of the section is in the work array."""

    rest: Array  # (6,), wrench at zero strain
    per_pressure: Array  # (6, N), wrench per pascal
    free_per_pa: float  # free strain of the radial pressure effect [1/Pa]


class TipPoses(NamedTuple):
    """Poses of the tip to fill in, one for each of K rows of pressures."""

    place: Array  # (K, 3) [m]
    turned: Array  # (K, 3, 3), rotation from the tip frame to the base frame
    good: Array  # (K,), whether a solution was found


class TipSensitivities(NamedTuple):
    """Poses of the tip to fill in, and their derivatives with respect to P changes."""

    place: Array  # (K, 3) [m]
    turned: Array  # (K, 3, 3)
    by: Array  # (K, P, 6), derivatives of position [m] and rotation vector [rad]
    good: Array  # (K,)
    unstable: Array  # (K,), whether only an unstable equilibrium was found


class SectionSensitivities(NamedTuple):
    """The same for S sections of the arm."""

    at: Array  # (S,) [m], arc lengths
    place: Array  # (K, S, 3) [m]
    turned: Array  # (K, S, 3, 3)
    by: Array  # (K, S, P, 6)
