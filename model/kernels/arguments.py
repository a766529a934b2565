"""Arguments of the kernels.

At each call numba looks up every field of a NamedTuple by its name, but not the items of a plain tuple. So Python
passes plain tuples of these fields, and the kernel builds the NamedTuple from them. `Walls` is an argument of its own,
because numba reads its type from the object instead of from its fields.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from model.kernels.jit import kernel
from model.kernels.law import Walls
from model.kernels.vec3 import inlined

Array = Any
Fields = tuple[Any, ...]


class Line(NamedTuple):
    """The line of the rod through the K segments of an arm, on N + 1 nodes. Many arms share `first`.

    The last node of a segment and the first node of the next one are the two ends of the coupling between them, a rigid
    body. So one interval between nodes is a step along a segment, or a joint.
    """

    first: Array  # (K + 1,), first node of each segment, then N + 1
    step: Array  # (K,) [m], step along each segment
    joint: Array  # (K, 3) [m], from the end of the line to the start of that of the next segment, in the section frame
    centre: Array  # (K, 2) [m], centroid of the walls of each segment


class ArmArguments(NamedTuple):
    """One arm with N + 1 nodes, from `model.kernel_arguments.KernelArguments`; many arms have a leading axis."""

    work: Array  # (K, size), for each segment the lanes and the section, as of `layout`; written to
    rest: Array  # (Q, K, 6), wrench at zero strain, for each row of pressures or one for all
    per_pressure: Array  # (K, 6, A), wrench per pascal of each of A chambers
    free_per_pa: Array  # (K,), free strain of the radial pressure effect [1/Pa]
    chambers: Array  # (K + 1,), first chamber of each segment, then A
    load: Array  # distributed load at nodes and mid-points, 2 N + 1 rows of 6, flat
    loaded: bool  # whether any load is not zero
    ends: Array  # (K, 19), load at the end of each segment, in the order of `layout.TIP_LOAD`
    length: Array  # [m], one number or (B,)
    scale: Array  # (32,), magnitudes of the states for Newton's method, then their reciprocals
    line: Any  # fields of `Line`


class LaneArguments(NamedTuple):
    """Perturbed copies of an arm in W work arrays of eight lanes, as of `lanes.apply_pressure`."""

    works: Array  # (W, K, size); written to
    rest: Array  # (Q, W, K, 6, 8)
    per_pressure: Array  # (W, K, 6, A, 8)
    free_per_pa: Array  # (W, K, 8)
    ends: Array  # (W, K, 19, 8), loads at the ends of the segments by cap and couplings
    loaded: bool  # whether any lane has a distributed load
    inertia: Array  # (K,), whether cap or coupling at the end of a segment has inertia in any lane
    branch_factors: Array  # (W, K, 1 + B, 3, 8), as of `MotionState`
    scale: Array  # (32,), as of `ArmArguments`


class MotionState(NamedTuple):
    """State of an arm in motion between two time steps; every array is written to."""

    last_pressures: Array  # (3, A) [Pa], of the last three time steps, the latest first
    segments: int  # number of shooting segments
    coefficients: Array  # (5,), c0, c1, c2, c3 and d1 of the time scheme (eq 26)
    past_states: Array  # (2, 2 N + 2, 16), solutions of the two time steps before the last
    x: Array  # (2 N + 2, 16), solution of the last time step: states at the nodes, then their derivatives
    branch_factors: Array  # (K, 1 + B, 3), of the Maxwell branches of the walls, as of `relaxation.relax_branches`
    branch_strains: Array  # (B, 2 N + 2, 6)


class Rod(NamedTuple):
    """One rod and its loads: a boundary value problem, as kernels hand it to kernels."""

    work: Array  # (K, size), as of `ArmArguments`; written to
    walls: Walls
    load: Array  # as of `ArmArguments`
    loaded: bool
    ends: Array  # (K, 19), load at the end of each segment; the last one is the tip
    length: float  # [m]
    scale: Array  # (32,)
    line: Line


class PressureWrench(NamedTuple):
    """Wrench of the pressures in the sections, and free strains; the stiffness is in the work arrays."""

    rest: Array  # (K, 6), wrench at zero strain
    per_pressure: Array  # (K, 6, A), wrench per pascal
    free_per_pa: Array  # (K,), free strain of the radial pressure effect [1/Pa]
    chambers: Array  # (K + 1,), first chamber of each segment, then A


@inlined
def segment_at(line: Line, node: int) -> int:
    """The segment that a node belongs to."""
    k = 0
    while node >= line.first[k + 1]:
        k += 1
    return k


@inlined
def interval_at(line: Line, at: float) -> tuple[int, float, int]:
    """The segment at an arc length from the base, and of the step there the arc length and number of its first node.

    A place on a coupling counts as the end of the segment before.
    """
    k, start = 0, 0.0
    for s in range(line.step.shape[0] - 1):
        after = start + line.step[s] * (line.first[s + 1] - 1 - line.first[s]) + line.joint[s, 2]
        if at < after:
            break
        k, start = s + 1, after
    steps = line.first[k + 1] - 1 - line.first[k]
    j = min(max(int((at - start) / line.step[k]), 0), steps - 1)
    return k, start + j * line.step[k], line.first[k] + j


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


def _counted(function: Any) -> Any:
    """Compile into every caller, and count the references: what returns an array must."""
    return kernel(function, inlined=True, called=False)


@_counted
def rod_of(arm: Any, walls: Any, ends: Any) -> Any:
    """The rod of an arm with loads at the ends of its segments."""
    line = Line(*arm.line)
    return Rod(arm.work, walls, arm.load, arm.loaded, ends, arm.length, arm.scale, line)


@_counted
def push_of(arm: Any, row: int) -> Any:
    """The wrench of the pressures of an arm for a row of pressures."""
    return PressureWrench(arm.rest[row % arm.rest.shape[0]], arm.per_pressure, arm.free_per_pa, arm.chambers)
