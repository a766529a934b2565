"""Kernels above the solver: the axis of the solved arm, motions over many time steps, equilibria of many arms."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import (
    ArmArguments,
    Fields,
    Line,
    MotionState,
    PressureWrench,
    Rod,
    TipPoses,
    interval_at,
    push_of,
    rod_of,
)
from model.kernels.between_nodes import displacement_between, orientation_between
from model.kernels.equilibrium import UNSTABLE, equilibrium
from model.kernels.jit import kernel
from model.kernels.law import Walls
from model.kernels.shooting import workspace_within
from model.kernels.time_stepping import advance
from model.kernels.vec3 import Triple, called, cross, inlined, leaf, plus, rotation, three

Array = Any


@inlined
def _to_base_frame(d1: Triple, d2: Triple, d3: Triple, a: Triple) -> Triple:
    """Transform a vector from the section frame, whose axes are d1, d2 and d3, to the base frame."""
    return plus(plus((a[0] * d1[0], a[0] * d1[1], a[0] * d1[2]), a[1], d2), a[2], d3)  # type: ignore[no-any-return]


@inlined
def _tangent(x: Array, j: int):  # type: ignore[no-untyped-def]
    """Derivative p' = R v (eq 7) of the line at node j, and the axes of the section."""
    d1, d2, d3 = rotation((x[j, 12], x[j, 13], x[j, 14], x[j, 15]))
    return _to_base_frame(d1, d2, d3, (x[j, 0], x[j, 1], x[j, 2])), d1, d2, d3


@inlined
def _tangent_slope(x: Array, j: int, d1: Triple, d2: Triple, d3: Triple) -> Triple:
    """Second derivative p'' = R (v' + u x v) of the line at node j."""
    slope = x.shape[0] // 2 + j
    strain, curvature = (x[j, 0], x[j, 1], x[j, 2]), (x[j, 3], x[j, 4], x[j, 5])
    return _to_base_frame(d1, d2, d3, plus((x[slope, 0], x[slope, 1], x[slope, 2]), 1.0, cross(curvature, strain)))  # type: ignore[no-any-return]


@inlined
def _position(tangent_sum: Triple, tangent: Triple, first_slope: Triple, tangent_slope: Triple, h: float) -> Triple:
    """Position of a node by the trapezoidal rule with end correction.

    tangent_sum: half of p' at the base plus p' of all nodes between. first_slope, tangent_slope: p'' at both ends.
    """
    at = plus(plus(tangent_sum, 0.5, tangent), h / 12.0, plus(first_slope, -1.0, tangent_slope))
    return h * at[0], h * at[1], h * at[2]


@inlined
def _write_pose(
    at: Triple, d1: Triple, d2: Triple, d3: Triple, centre: Array, k: int, p: Array, rotations: Array, j: int
) -> None:
    """Write the pose of the axis in segment k into row j: the line, shifted from the centroid of its walls (eq 29)."""
    cx, cy = centre[k, 0], centre[k, 1]
    for c in range(3):
        rotations[j, c, 0], rotations[j, c, 1], rotations[j, c, 2] = d1[c], d2[c], d3[c]
        p[j, c] = at[c] - d1[c] * cx - d2[c] * cy
    p[j, 0] += centre[0, 0]
    p[j, 1] += centre[0, 1]


@inlined
def _line_to(x: Array, line: Line, last: int):  # type: ignore[no-untyped-def]
    """Position, p' and p'' of the line at node `last`, and the axes of the section there."""
    k = 0
    origin = (0.0, 0.0, 0.0)
    while True:
        begin, h = line.first[k], line.step[k]
        end = min(line.first[k + 1] - 1, last)
        tangent, d1, d2, d3 = _tangent(x, begin)
        slope = _tangent_slope(x, begin, d1, d2, d3)
        first_slope, at = slope, origin
        tangent_sum = (0.5 * tangent[0], 0.5 * tangent[1], 0.5 * tangent[2])
        for j in range(begin + 1, end):
            tangent, _, _, _ = _tangent(x, j)
            tangent_sum = plus(tangent_sum, 1.0, tangent)
        if end > begin:
            tangent, d1, d2, d3 = _tangent(x, end)
            slope = _tangent_slope(x, end, d1, d2, d3)
            at = plus(origin, 1.0, _position(tangent_sum, tangent, first_slope, slope, h))
        if end == last:
            return at, tangent, slope, d1, d2, d3
        origin = plus(at, 1.0, _to_base_frame(d1, d2, d3, three(line.joint[k], 0)))
        k += 1


@called
def axis(x: Array, line_fields: Fields, p: Array, rotations: Array, v: Array, u: Array) -> None:
    """Positions, rotations and strains of the arm's axis from the solved states of the line through the centroids.

    Integrates p' = R v (eq 7) by the trapezoidal rule with end correction (fourth order), then shifts the line from the
    centroid to the axis as in eq 29: p + centre - R centre. x (2 N + 2, 16): states, then their derivatives.
    """
    line = Line(*line_fields)
    origin = (0.0, 0.0, 0.0)
    for k in range(line.step.shape[0]):
        begin, end = line.first[k], line.first[k + 1] - 1
        cx, cy = line.centre[k, 0], line.centre[k, 1]
        tangent, d1, d2, d3 = _tangent(x, begin)
        first_slope, at = _tangent_slope(x, begin, d1, d2, d3), origin
        tangent_sum = (0.5 * tangent[0], 0.5 * tangent[1], 0.5 * tangent[2])
        for j in range(begin, end + 1):
            if j > begin:
                tangent, d1, d2, d3 = _tangent(x, j)
                slope = _tangent_slope(x, j, d1, d2, d3)
                at = plus(origin, 1.0, _position(tangent_sum, tangent, first_slope, slope, line.step[k]))
                tangent_sum = plus(tangent_sum, 1.0, tangent)
            _write_pose(at, d1, d2, d3, line.centre, k, p, rotations, j)
            u1, u2, u3 = x[j, 3], x[j, 4], x[j, 5]
            v[j, 0], v[j, 1], v[j, 2] = x[j, 0] + u3 * cy, x[j, 1] - u3 * cx, x[j, 2] - u1 * cy + u2 * cx
            u[j, 0], u[j, 1], u[j, 2] = u1, u2, u3
        origin = plus(at, 1.0, _to_base_frame(d1, d2, d3, three(line.joint[k], 0)))


@leaf
def write_tip_pose(x: Array, line: Line, place: Array, rotations: Array, t: int) -> None:
    """Write the pose of the tip into row t of place (T, 3) and rotations (T, 3, 3)."""
    at, _, _, d1, d2, d3 = _line_to(x, line, x.shape[0] // 2 - 1)
    _write_pose(at, d1, d2, d3, line.centre, line.step.shape[0] - 1, place, rotations, t)


@leaf
def write_section_pose(x: Array, line: Line, at: float, place: Array, rotations: Array, row: int) -> None:
    """Write the pose of the section at arc length `at` into a row of place (S, 3) and rotations (S, 3, 3)."""
    k, start, last = interval_at(line, at)
    h = line.step[k]
    position, tangent, tangent_slope, _, _, _ = _line_to(x, line, last)
    next_tangent, d1, d2, d3 = _tangent(x, last + 1)
    t = min((at - start) / h, 1.0)
    step = displacement_between(tangent, tangent_slope, next_tangent, _tangent_slope(x, last + 1, d1, d2, d3), t, h)
    d1, d2, d3 = rotation(
        orientation_between(
            (x[last, 12], x[last, 13], x[last, 14], x[last, 15]), (x[last, 3], x[last, 4], x[last, 5]),
            (x[last + 1, 12], x[last + 1, 13], x[last + 1, 14], x[last + 1, 15]),
            (x[last + 1, 3], x[last + 1, 4], x[last + 1, 5]), t, h,
        )
    )  # fmt: skip
    _write_pose(plus(position, 1.0, step), d1, d2, d3, line.centre, k, place, rotations, row)


@kernel
def motion(
    walls: Walls,
    arm_fields: Fields,
    state_fields: Fields,
    pressure: Array,
    pool: Array,
    tolerance: float,
    tip_fields: Fields,
) -> int:
    """Advance by one time step for each row of pressure (T, N) [Pa]; fills the tips (T,).

    pool: the array of a workspace, as of `shooting.workspace_within`. Returns the number of Newton iterations, or -1
    and changes nothing if a pressure is not finite.
    """
    arm, state, tips = ArmArguments(*arm_fields), MotionState(*state_fields), TipPoses(*tip_fields)
    for t in range(pressure.shape[0]):
        for k in range(pressure.shape[1]):
            if not abs(pressure[t, k]) < np.inf:
                return -1
    total, workspace = 0, workspace_within(pool, state.x.shape[0] // 2 - 1, state.branch_strains.shape[0])
    rod = rod_of(arm, walls, arm.ends)
    for t in range(pressure.shape[0]):
        passes = advance(rod, push_of(arm, t), state, pressure[t], workspace, tolerance)
        tips.good[t] = passes > 0
        if passes > 0:
            total += passes
        write_tip_pose(state.x, rod.line, tips.place, tips.turned, t)
    return total


@kernel
def equilibria(
    walls: Walls,
    arm_fields: Fields,
    pressure: Array,
    pool: Array,
    tolerance: float,
    tip_fields: Fields,
    unstable: Array,
) -> None:
    """Solve one equilibrium for each row of pressure (B, A) [Pa]; fills the tips and unstable (B,).

    Arms have a leading axis: one for each row, or one for all rows.
    """
    arms, tips = ArmArguments(*arm_fields), TipPoses(*tip_fields)
    lines = Line(*arms.line)
    workspace = workspace_within(pool, arms.load.shape[1] // 12, 0)
    for b in range(pressure.shape[0]):
        k = b % arms.work.shape[0]
        line = Line(lines.first, lines.step[k], lines.joint[k], lines.centre[k])
        rod = Rod(arms.work[k], walls, arms.load[k], arms.loaded, arms.ends[k], arms.length[k], arms.scale[k], line)
        rest = arms.rest[b % arms.rest.shape[0]]
        push = PressureWrench(rest, arms.per_pressure[k], arms.free_per_pa[k], arms.chambers)
        passes = equilibrium(rod, push, pressure[b], workspace, tolerance)
        tips.good[b], unstable[b] = passes > 0, passes == UNSTABLE
        if passes > 0:
            write_tip_pose(workspace.x, line, tips.place, tips.turned, b)
        else:
            tips.place[b] = np.nan
            tips.turned[b] = np.nan
