"""Arguments of the outer kernels: an arm, its neighbours in lanes, its motion, and the poses to fill in.

`Walls` stays an argument of its own: numba's dispatcher knows its type, but would inspect each field of a tuple that
holds it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

Array = Any


class ArmArguments(NamedTuple):
    """One arm on N + 1 nodes, as `model.kernel_arguments.KernelArguments` prepares it; several have a leading axis."""

    work: Array  # (size,), with a section in it; written to
    stiffness: Array  # (R, 24), one for each row of pressures or one for all
    rest: Array  # (Q, 6), wrench at zero strain, the same
    per_pressure: Array  # (R, 6, N)
    free_per_pa: Array  # a number, or one for each arm
    load: Array  # at nodes and mid-points, 2 N + 1 rows of 6, flat
    loaded: bool  # whether any load is not zero
    tip: Array  # (19,), what hangs on the tip
    length: Array  # [m], a number, or one for each arm
    scale: Array
    centre: Array  # (2,) [m], the centroid of the walls


class LaneArguments(NamedTuple):
    """The neighbours of an arm, as `lanes.apply_pressure` takes them; sections as of the arm."""

    works: Array  # (W, size); written to
    stiffness: Array
    rest: Array
    per_pressure: Array
    frees: Array
    ends: Array
    loaded: bool  # whether any lane has a distributed load
    heavy: bool  # whether the cap has inertia
    branch_factors: Array  # (W, 1 + B, 3, 8), as of `MotionState`


class MotionState(NamedTuple):
    """Where a motion stands; every array is written to."""

    before: Array  # (3, N) [Pa], the pressures of the last steps
    segments: int  # parts of the arm that are shot at once
    coefficients: Array  # (5,), of the time scheme (eq 26)
    past_states: Array  # (2, 2 N + 2, 16)
    x: Array  # (2 N + 2, 16), states at the nodes, then their slopes
    branch_factors: Array  # (1 + B, 3), of the walls' Maxwell branches, as of `relaxation.relax_branches`
    branch_strains: Array  # (B, 2 N + 2, 6)


class TipPoses(NamedTuple):
    """Poses of the tip to fill in, one for each row of pressures."""

    place: Array  # (K, 3) [m]
    turned: Array  # (K, 3, 3)
    good: Array  # (K,)


class TipAnswers(NamedTuple):
    """Poses of the tip to fill in, and how they answer to each neighbour's change."""

    place: Array  # (K, 3) [m]
    turned: Array  # (K, 3, 3)
    by: Array  # (K, P, 6)
    good: Array  # (K,)
    unstable: Array  # (K,)


class SectionAnswers(NamedTuple):
    """Poses of sections of the arm to fill in, and how they answer to each neighbour's change."""

    at: Array  # (S,) [m], arc lengths
    place: Array  # (K, S, 3) [m]
    turned: Array  # (K, S, 3, 3)
    by: Array  # (K, S, P, 6)
