"""Perturbed copies of an arm side by side in SIMD lanes: their pressures, loads and poses.

Each lane has its own length, section, pressures, loads and history. Lanes are numbered through all work arrays: lane 0
is the arm, each of lanes 1 to 6 perturbs one base strain, and the copies with a perturbed parameter follow.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from model.kernels.arguments import LaneArguments, Line, interval_at
from model.kernels.between_nodes import Quaternion, displacement_between, orientation_between
from model.kernels.law import Walls
from model.kernels.layout import (
    ALL_TRIOS,
    AXIS_SUM,
    CENTRE,
    ECCENTRIC_FORCE,
    JOINT,
    LANES,
    NODE,
    OFFSET,
    PER_TUBE,
    SLOPE,
    STATE,
    STEP_LENGTH,
    THIRD,
    TIP_LOAD,
    TIP_LOAD_SIZE,
    TRIO,
    aligned,
)
from model.kernels.vec3 import Triple, called, cross, inlined, leaf, plus, put, rotation, triple

Array = Any

FIRST = 7  # lane of the first perturbed copy


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


@leaf
def apply_pressure(
    lanes: LaneArguments, walls: Walls, chambers: Array, t: int, pressure: Array, tip_loads: Array
) -> None:
    """Write pressures (W, A, 8) and loads at the ends into the work arrays, lane by lane, for row t.

    tip_loads (W, 12, 8): force and moment at the tip beside those of the cap, and the eccentric force with its point.
    """
    first = TRIO if walls.tubes <= 3 else ALL_TRIOS
    rest, tip = lanes.rest[t % lanes.rest.shape[0]], lanes.works.shape[1] - 1
    for p in range(lanes.works.shape[0]):
        for s in range(tip + 1):
            w = lanes.works[p, s]
            begin, end = chambers[s], chambers[s + 1]
            for c in range(6):
                for i in range(LANES):
                    total = rest[p, s, c, i]
                    for k in range(begin, end):
                        total += lanes.per_pressure[p, s, c, k, i] * pressure[p, k, i]
                    w[(OFFSET + c) * LANES + i] = total
            for c in range(TIP_LOAD_SIZE):
                for i in range(LANES):
                    w[(TIP_LOAD + c) * LANES + i] = lanes.ends[p, s, c, i]
            for k in range(begin, end):
                at = (first + PER_TUBE * (k - begin) + 2) * LANES
                for i in range(LANES):
                    w[at + i] = lanes.free_per_pa[p, s, i] * pressure[p, k, i]
        w = lanes.works[p, tip]
        for c in range(6):
            for i in range(LANES):
                w[(TIP_LOAD + c) * LANES + i] += tip_loads[p, c, i]
                w[(ECCENTRIC_FORCE + c) * LANES + i] += tip_loads[p, 6 + c, i]


@called
def apply_tip_load(own: Array, tip_loads: Array, ends: Array) -> None:
    """Fill the loads at the ends (K, 19) of the arm in lane 0: its own, and the load that `apply_pressure` adds."""
    tip = own.shape[0] - 1
    for s in range(tip + 1):
        for c in range(TIP_LOAD_SIZE):
            ends[s, c] = own[s, c]
    for c in range(6):
        ends[tip, c] += tip_loads[0, c, 0]
        ends[tip, TIP_LOAD_SIZE - 6 + c] += tip_loads[0, 6 + c, 0]


@inlined
def _integrate_axis(works: Array, line: Line, states: Array, derivatives: Array, last: int) -> int:
    """Integrate the line from the base to node `last` in every lane, as `axis.axis` does.

    works (K, size). Writes the position, p' and p'' to AXIS_SUM, and the state of the node to NODE, of the segment of
    that node, which it returns.
    """
    k = 0
    w = works[0]
    for i in range(9 * LANES):
        w[AXIS_SUM * LANES + i] = 0.0
    for j in range(last + 1):
        starts = j == line.first[k]
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
            h = 0.0 if starts else w[STEP_LENGTH * LANES + i]
            at = plus(
                plus(at, 0.5 * h, plus(last_tangent, 1.0, tangent)), h * h / 12.0, plus(last_slope, -1.0, tangent_slope)
            )
            put(w, AXIS_SUM, i, at)
            put(w, AXIS_SUM + 3, i, tangent)
            put(w, AXIS_SUM + 6, i, tangent_slope)
        if j < last and j + 1 == line.first[k + 1]:
            k += 1
            after = works[k]
            for i in range(LANES):
                d1, d2, d3 = rotation(_orientation(w, i))
                a, b, c = triple(w, JOINT, i)
                put(after, AXIS_SUM, i, plus(plus(plus(triple(w, AXIS_SUM, i), a, d1), b, d2), c, d3))
                put(after, AXIS_SUM + 3, i, (0.0, 0.0, 0.0))
                put(after, AXIS_SUM + 6, i, (0.0, 0.0, 0.0))
            w = after
    return k


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
def _write_lane_pose(
    base: Array, w: Array, i: int, at: Triple, own: Quaternion, other: Quaternion, place: Array
) -> None:
    """Write the position of lane i on the axis, and its rotation vector against the orientation `other`.

    base: the work array of the first segment; w: that of the segment of the place.
    """
    d1, d2, _ = rotation(own)
    moved = plus(plus(at, -w[CENTRE * LANES + i], d1), -w[(CENTRE + 1) * LANES + i], d2)
    cx, cy = base[CENTRE * LANES + i], base[(CENTRE + 1) * LANES + i]
    place[0, i], place[1, i], place[2, i] = moved[0] + cx, moved[1] + cy, moved[2]
    a, b, c, e = own
    a0, b0, c0, e0 = other
    over = 2.0 / (a0 * a0 + b0 * b0 + c0 * c0 + e0 * e0)
    place[3, i] = over * (-a * b0 + b * a0 - c * e0 + e * c0)
    place[4, i] = over * (-a * c0 + c * a0 - e * b0 + b * e0)
    place[5, i] = over * (-a * e0 + e * a0 - b * c0 + c * b0)


@leaf
def tip_poses(works: Array, line: Line, states: Array, derivatives: Array, tip: Array, place: Array) -> None:
    """Write position (3) and rotation vector (3) of the tip in every lane into place (6, 8), as of `axis.axis`.

    works (K, size). The rotation vector [rad], in the base frame, leads from the orientation of the state `tip` (16,)
    to that of the lane, to first order.
    """
    w = works[_integrate_axis(works, line, states, derivatives, states.shape[0] - 1)]
    other = tip[12], tip[13], tip[14], tip[15]
    for i in range(LANES):
        _write_lane_pose(works[0], w, i, triple(w, AXIS_SUM, i), _orientation(w, i), other, place)


@leaf
def section_poses(
    works: Array, line: Line, states: Array, derivatives: Array, at: float, x: Array, place: Array
) -> None:
    """Write the same of the section at arc length `at`, against that of the arm x (2 N + 2, 16).

    Every lane is interpolated between the same two nodes, whose arc lengths depend on the lengths of its segments.
    """
    k, start, last = interval_at(line, at)
    h = line.step[k]
    other = orientation_between(
        (x[last, 12], x[last, 13], x[last, 14], x[last, 15]), (x[last, 3], x[last, 4], x[last, 5]),
        (x[last + 1, 12], x[last + 1, 13], x[last + 1, 14], x[last + 1, 15]),
        (x[last + 1, 3], x[last + 1, 4], x[last + 1, 5]), min((at - start) / h, 1.0), h,
    )  # fmt: skip
    _integrate_axis(works, line, states, derivatives, last)
    w = works[k]
    for i in range(STATE * LANES):
        w[THIRD * LANES + i] = w[NODE * LANES + i]
        w[NODE * LANES + i] = states[last + 1, i]
    for i in range(6 * LANES):
        w[SLOPE * LANES + i] = derivatives[last + 1, i]
    for i in range(LANES):
        h = w[STEP_LENGTH * LANES + i]
        before_segment = 0.0
        for s in range(k):
            own_step = works[s, STEP_LENGTH * LANES + i]
            before_segment += own_step * (line.first[s + 1] - 1 - line.first[s]) + works[s, (JOINT + 2) * LANES + i]
        t = min((at - before_segment) / h - (last - line.first[k]), 1.0)
        tangent, tangent_slope = _tangents(w, i)
        step = displacement_between(
            triple(w, AXIS_SUM + 3, i), triple(w, AXIS_SUM + 6, i), tangent, tangent_slope, t, h
        )
        q = (THIRD + 12) * LANES + i
        before = w[q], w[q + LANES], w[q + 2 * LANES], w[q + 3 * LANES]
        own = orientation_between(before, triple(w, THIRD + 3, i), _orientation(w, i), triple(w, NODE + 3, i), t, h)
        _write_lane_pose(works[0], w, i, plus(triple(w, AXIS_SUM, i), 1.0, step), own, other, place)
