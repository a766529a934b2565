"""Kernels that integrate perturbed copies of an arm side by side in SIMD lanes, from the base to the tip.

Each lane has its own length, section, pressures, loads and history. Lanes are numbered through all work arrays: lane 0
is the arm, each of lanes 1 to 6 perturbs one base strain, and the copies with a perturbed parameter follow.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from model.kernels.arguments import LaneArguments, Rod
from model.kernels.between_nodes import Quaternion, displacement_between, orientation_between
from model.kernels.law import Walls, branched
from model.kernels.layout import (
    ALL_TRIOS,
    AXIAL,
    AXIS_SUM,
    CENTRE,
    ECCENTRIC_FORCE,
    FOURTH,
    LANES,
    NODE,
    OFFSET,
    PAST,
    PER_TUBE,
    SLOPE,
    STAGE,
    STATE,
    STEP_LENGTH,
    THIRD,
    TIP_LOAD,
    TIP_LOAD_SIZE,
    TRIO,
    aligned,
)
from model.kernels.rod import stage
from model.kernels.vec3 import Triple, called, cross, inlined, leaf, plus, put, rotation, triple

Array = Any

FIRST = 7  # lane of the first perturbed copy
UNUSED_HISTORY = ((0.0, 0.0, 0.0),) * 8  # argument in place of a history that all lanes share


class SensitivityWorkspace(NamedTuple):
    """Arrays of the sensitivity kernels, for W work arrays, P perturbed copies and S segments."""

    states: Array  # (2, W, N + 1, 128), of this and of the previous time step
    derivatives: Array  # of the same shape: derivatives of the states along the arm
    directions: Array  # (S, 6, 16), per segment
    triangle: Array  # (S, 6, 6)
    projections: Array  # (S, P, 6), of the perturbed copies on the directions, per segment
    parts: Array  # (P, 16), difference of each copy at the start of a segment
    shares: Array  # (S, W, 6, 8), weights of the perturbed base strains in each lane
    matrix: Array  # (6, 6)
    right: Array  # (P, 6)
    place: Array  # (W, 6, 8), position and rotation vector of the tip in every lane
    past: Array  # (W, N + 1, 192), history of the lanes in motion; (W, N + 1, 288) with B > 0 Maxwell branches
    branch_strains: Array  # (W, B, N + 1, 96)

    @classmethod
    def of(cls, copies: int, n: int, segments: int, branches: int = 0) -> SensitivityWorkspace:
        """Allocate the arrays for P perturbed copies and N steps along the arm, whose walls have B Maxwell branches."""
        works = work_arrays(copies)
        size = 2, works, n + 1, STATE * LANES
        return cls(
            aligned(*size), aligned(*size), aligned(segments, 6, STATE), aligned(segments, 6, 6),
            aligned(segments, copies, 6), aligned(copies, STATE),
            aligned(segments, works, 6, LANES), aligned(6, 6), aligned(copies, 6), aligned(works, 6, LANES),
            aligned(works, n + 1, (36 if branches else 24) * LANES), aligned(works, branches, n + 1, 12 * LANES),
        )  # fmt: skip


def work_arrays(copies: int) -> int:
    """Number of work arrays, of eight lanes each, for P perturbed copies."""
    return -(-(FIRST + copies) // LANES)


@inlined
def _load_history(w: Array, walls: Walls, past: Array) -> None:
    """Load the history at a node, and the past strains of the walls, into the work array."""
    for i in range(12 * LANES):
        w[PAST * LANES + i] = past[i]
    slope = 30 * LANES if branched(walls.law) else 12 * LANES
    for i in range(6 * LANES):
        w[(PAST + 12) * LANES + i] = past[slope + i]
    if branched(walls.law):
        for i in range(6 * LANES):
            w[(PAST + 18) * LANES + i] = past[24 * LANES + i]


@inlined
def _interpolate_history(w: Array, walls: Walls, a: Array, b: Array) -> None:
    """Load the same half-way between two nodes, as `time_stepping.interpolate_midpoints` does."""
    for c in range(12):
        for i in range(LANES):
            at, to = c * LANES + i, (12 + c) * LANES + i
            bent = 0.125 * w[STEP_LENGTH * LANES + i] * (a[to] - b[to])
            w[PAST * LANES + at] = 0.5 * (a[at] + b[at]) + bent
    own, slope = (24, 30) if branched(walls.law) else (0, 12)
    for c in range(6):
        for i in range(LANES):
            at, to, k = (own + c) * LANES + i, (slope + c) * LANES + i, (12 + c) * LANES + i
            w[PAST * LANES + k] = 1.5 / w[STEP_LENGTH * LANES + i] * (b[at] - a[at]) - 0.25 * (a[to] + b[to])
    if branched(walls.law):
        for c in range(6):
            for i in range(LANES):
                at, to = (24 + c) * LANES + i, (30 + c) * LANES + i
                bent = 0.125 * w[STEP_LENGTH * LANES + i] * (a[to] - b[to])
                w[(PAST + 18 + c) * LANES + i] = 0.5 * (a[at] + b[at]) + bent


@leaf
def integrate_lanes(
    rod: Rod, past: Array, moving: bool, first: int, last: int, states: Array, derivatives: Array
) -> None:
    """Integrate the state at NODE in all lanes from node `first` to node `last`, as `rod.integrate` does.

    rod: the arm with one work array of the lanes. past (N + 1, 192 or 288): as of `SensitivityWorkspace`, history of
    strains, velocities and their derivatives at the nodes, and past strains of walls with Maxwell branches; read only
    if `moving`.
    """
    w, walls, size, n = rod.work, rod.walls, STATE * LANES, states.shape[0] - 1
    for j in range(first, last + 1):
        if j == last and last < n:
            break
        for i in range(size):
            states[j, i] = w[NODE * LANES + i]
        if moving:
            _load_history(w, walls, past[j])
        stage(rod, UNUSED_HISTORY, True, 2 * j, NODE, STAGE, 0.5)
        for i in range(12 * LANES):
            derivatives[j, i] = w[SLOPE * LANES + i]
        if j == n:
            break
        if moving:
            _interpolate_history(w, walls, past[j], past[j + 1])
        stage(rod, UNUSED_HISTORY, True, 2 * j + 1, STAGE, THIRD, 0.5)
        stage(rod, UNUSED_HISTORY, True, 2 * j + 1, THIRD, FOURTH, 1.0)
        if moving:
            _load_history(w, walls, past[j + 1])
        stage(rod, UNUSED_HISTORY, True, 2 * j + 2, FOURTH, NODE, 1.0 / 6.0)


@leaf
def apply_pressure(lanes: LaneArguments, actuators: int, t: int, pressure: Array, tip_loads: Array) -> None:
    """Write sections, pressures (W, N, 8) and loads at the tip into the work arrays, lane by lane, for row t.

    tip_loads (W, 12, 8): force and moment beside those of the cap, and the eccentric force with its point.
    """
    first = TRIO if actuators <= 3 else ALL_TRIOS
    r, q = t % lanes.stiffness.shape[0], t % lanes.rest.shape[0]
    stiffness, rest, per_pressure = lanes.stiffness[r], lanes.rest[q], lanes.per_pressure[r]
    for p in range(lanes.works.shape[0]):
        w = lanes.works[p]
        for c in range(24):
            for i in range(LANES):
                w[(AXIAL + c) * LANES + i] = stiffness[p, c, i]
        for c in range(6):
            for i in range(LANES):
                total = rest[p, c, i]
                for k in range(actuators):
                    total += per_pressure[p, c, k, i] * pressure[p, k, i]
                w[(OFFSET + c) * LANES + i] = total
        for c in range(TIP_LOAD_SIZE):
            for i in range(LANES):
                w[(TIP_LOAD + c) * LANES + i] = lanes.cap_loads[p, c, i]
        for c in range(6):
            for i in range(LANES):
                w[(TIP_LOAD + c) * LANES + i] += tip_loads[p, c, i]
                w[(ECCENTRIC_FORCE + c) * LANES + i] += tip_loads[p, 6 + c, i]
        for k in range(actuators):
            for i in range(LANES):
                w[(first + PER_TUBE * k + 2) * LANES + i] = lanes.free_per_pa[p, i] * pressure[p, k, i]


@called
def apply_tip_load(cap_load: Array, tip_loads: Array, tip_load: Array) -> None:
    """Fill the tip load (19,) of the arm in lane 0: that of its cap, and the load that `apply_pressure` adds."""
    for c in range(TIP_LOAD_SIZE):
        tip_load[c] = cap_load[c]
    for c in range(6):
        tip_load[c] += tip_loads[0, c, 0]
        tip_load[TIP_LOAD_SIZE - 6 + c] += tip_loads[0, 6 + c, 0]


@inlined
def _integrate_axis(w: Array, states: Array, derivatives: Array, last: int) -> None:
    """Integrate the line from the base to node `last` in every lane, as `axis.axis` does.

    Writes the position, p' and p'' to AXIS_SUM, and the state of the node to NODE.
    """
    for i in range(9 * LANES):
        w[AXIS_SUM * LANES + i] = 0.0
    for j in range(last + 1):
        for i in range(STATE * LANES):
            w[NODE * LANES + i] = states[j, i]
        for i in range(6 * LANES):
            w[SLOPE * LANES + i] = derivatives[j, i]
        for i in range(LANES):
            at, last_tangent, last_slope = (
                triple(w, AXIS_SUM, i),
                triple(w, AXIS_SUM + 3, i),
                triple(w, AXIS_SUM + 6, i),
            )
            tangent, tangent_slope = _tangents(w, i)
            h = w[STEP_LENGTH * LANES + i] if j > 0 else 0.0
            at = plus(
                plus(at, 0.5 * h, plus(last_tangent, 1.0, tangent)), h * h / 12.0, plus(last_slope, -1.0, tangent_slope)
            )
            put(w, AXIS_SUM, i, at)
            put(w, AXIS_SUM + 3, i, tangent)
            put(w, AXIS_SUM + 6, i, tangent_slope)


@inlined
def _tangents(w: Array, i: int) -> tuple[Triple, Triple]:
    """Derivatives p' and p'' of the line in lane i, from the state of the node and its derivatives."""
    d1, d2, d3 = rotation(_orientation(w, i))
    strain = triple(w, NODE, i)
    g = plus(triple(w, SLOPE, i), 1.0, cross(triple(w, NODE + 3, i), strain))
    tangent = plus(plus((strain[0] * d1[0], strain[0] * d1[1], strain[0] * d1[2]), strain[1], d2), strain[2], d3)
    return tangent, plus(plus((g[0] * d1[0], g[0] * d1[1], g[0] * d1[2]), g[1], d2), g[2], d3)


@inlined
def _orientation(w: Array, i: int) -> Quaternion:
    q = (NODE + 12) * LANES + i
    return w[q], w[q + LANES], w[q + 2 * LANES], w[q + 3 * LANES]


@inlined
def _write_lane_pose(w: Array, i: int, at: Triple, own: Quaternion, other: Quaternion, place: Array) -> None:
    """Write the position of lane i on the axis, and its rotation vector against the orientation `other`."""
    d1, d2, _ = rotation(own)
    cx, cy = w[CENTRE * LANES + i], w[(CENTRE + 1) * LANES + i]
    moved = plus(plus(at, -cx, d1), -cy, d2)
    place[0, i], place[1, i], place[2, i] = moved[0] + cx, moved[1] + cy, moved[2]
    a, b, c, e = own
    a0, b0, c0, e0 = other
    over = 2.0 / (a0 * a0 + b0 * b0 + c0 * c0 + e0 * e0)
    place[3, i] = over * (-a * b0 + b * a0 - c * e0 + e * c0)
    place[4, i] = over * (-a * c0 + c * a0 - e * b0 + b * e0)
    place[5, i] = over * (-a * e0 + e * a0 - b * c0 + c * b0)


@leaf
def tip_poses(w: Array, states: Array, derivatives: Array, tip: Array, place: Array) -> None:
    """Write position (3) and rotation vector (3) of the tip in every lane into place (6, 8), as of `axis.axis`.

    The rotation vector [rad], in the base frame, leads from the orientation of the state `tip` (16,) to that of the
    lane, to first order.
    """
    _integrate_axis(w, states, derivatives, states.shape[0] - 1)
    for i in range(LANES):
        _write_lane_pose(w, i, triple(w, AXIS_SUM, i), _orientation(w, i), (tip[12], tip[13], tip[14], tip[15]), place)


@leaf
def section_poses(
    w: Array, states: Array, derivatives: Array, at: float, length: float, x: Array, place: Array
) -> None:
    """Write the same of the section at arc length `at`, against that of the arm x (2 N + 2, 16) of a length.

    Every lane is interpolated between the same two nodes, whose arc lengths depend on the length of its arm.
    """
    n = states.shape[0] - 1
    last = min(max(int(at * n / length), 0), n - 1)
    h = length / n
    other = orientation_between(
        (x[last, 12], x[last, 13], x[last, 14], x[last, 15]), (x[last, 3], x[last, 4], x[last, 5]),
        (x[last + 1, 12], x[last + 1, 13], x[last + 1, 14], x[last + 1, 15]),
        (x[last + 1, 3], x[last + 1, 4], x[last + 1, 5]), at / h - last, h,
    )  # fmt: skip
    _integrate_axis(w, states, derivatives, last)
    for i in range(STATE * LANES):
        w[THIRD * LANES + i] = w[NODE * LANES + i]
        w[NODE * LANES + i] = states[last + 1, i]
    for i in range(6 * LANES):
        w[SLOPE * LANES + i] = derivatives[last + 1, i]
    for i in range(LANES):
        h = w[STEP_LENGTH * LANES + i]
        t = at / h - last
        tangent, tangent_slope = _tangents(w, i)
        step = displacement_between(
            triple(w, AXIS_SUM + 3, i), triple(w, AXIS_SUM + 6, i), tangent, tangent_slope, t, h
        )
        q = (THIRD + 12) * LANES + i
        before = w[q], w[q + LANES], w[q + 2 * LANES], w[q + 3 * LANES]
        own = orientation_between(before, triple(w, THIRD + 3, i), _orientation(w, i), triple(w, NODE + 3, i), t, h)
        _write_lane_pose(w, i, plus(triple(w, AXIS_SUM, i), 1.0, step), own, other, place)
