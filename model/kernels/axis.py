"""Kernels on top of the solver: the arm's axis, whole motions, many arms."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import ArmArguments, MotionState, TipPoses
from model.kernels.between_nodes import orientation_between, passed_between
from model.kernels.equilibrium import UNSTABLE, equilibrium
from model.kernels.jit import kernel
from model.kernels.law import Walls
from model.kernels.shooting import Workspace, workspace_within
from model.kernels.time_stepping import advance, stiffen
from model.kernels.vec3 import Triple, called, cross, inlined, leaf, plus, rotation

Array = Any


@inlined
def _turned(d1: Triple, d2: Triple, d3: Triple, a: Triple) -> Triple:
    """A vector of the section, whose axes are given, in the base frame."""
    return plus(plus((a[0] * d1[0], a[0] * d1[1], a[0] * d1[2]), a[1], d2), a[2], d3)  # type: ignore[no-any-return]


@inlined
def _speed(x: Array, j: int):  # type: ignore[no-untyped-def]
    """At node j the line's slope p' = R v (eq 7), and the section's axes."""
    d1, d2, d3 = rotation((x[j, 12], x[j, 13], x[j, 14], x[j, 15]))
    return _turned(d1, d2, d3, (x[j, 0], x[j, 1], x[j, 2])), d1, d2, d3


@inlined
def _bend(x: Array, j: int, d1: Triple, d2: Triple, d3: Triple) -> Triple:
    """At node j the slope of that slope, R (v' + u x v)."""
    slope = x.shape[0] // 2 + j
    strain, curvature = (x[j, 0], x[j, 1], x[j, 2]), (x[j, 3], x[j, 4], x[j, 5])
    return _turned(d1, d2, d3, plus((x[slope, 0], x[slope, 1], x[slope, 2]), 1.0, cross(curvature, strain)))  # type: ignore[no-any-return]


@inlined
def _reached(passed: Triple, speed: Triple, first: Triple, bend: Triple, h: float) -> Triple:
    """Place of a node: passed holds half the first slope and all slopes in between, first and bend the ends' slopes."""
    at = plus(plus(passed, 0.5, speed), h / 12.0, plus(first, -1.0, bend))
    return h * at[0], h * at[1], h * at[2]


@inlined
def _write_axis(at: Triple, d1: Triple, d2: Triple, d3: Triple, centre: Array, p: Array, turned: Array, j: int) -> None:
    cx, cy = centre[0], centre[1]
    for k in range(3):
        turned[j, k, 0], turned[j, k, 1], turned[j, k, 2] = d1[k], d2[k], d3[k]
        p[j, k] = at[k] - d1[k] * cx - d2[k] * cy
    p[j, 0] += cx
    p[j, 1] += cy


@called
def axis(x: Array, length: float, centre: Array, p: Array, rotations: Array, v: Array, u: Array) -> None:
    """Positions, orientations and strains of the arm's axis from the solved states of the line through the centroid.

    Integrates p' = R v (eq 7) by the trapezoid corrected with end slopes, of fourth order, then moves from the centroid
    to the axis as eq 29 does: p + centre - R centre. x (2 N + 2, 16): states, then slopes.
    """
    n, cx, cy = p.shape[0] - 1, centre[0], centre[1]
    speed, d1, d2, d3 = _speed(x, 0)
    passed, first, at = (0.5 * speed[0], 0.5 * speed[1], 0.5 * speed[2]), _bend(x, 0, d1, d2, d3), (0.0, 0.0, 0.0)
    for j in range(n + 1):
        if j > 0:
            speed, d1, d2, d3 = _speed(x, j)
            at = _reached(passed, speed, first, _bend(x, j, d1, d2, d3), length / n)
            passed = plus(passed, 1.0, speed)
        _write_axis(at, d1, d2, d3, centre, p, rotations, j)
        u1, u2, u3 = x[j, 3], x[j, 4], x[j, 5]
        v[j, 0], v[j, 1], v[j, 2] = x[j, 0] + u3 * cy, x[j, 1] - u3 * cx, x[j, 2] - u1 * cy + u2 * cx
        u[j, 0], u[j, 1], u[j, 2] = u1, u2, u3


@leaf
def place_tip(x: Array, length: float, centre: Array, place: Array, turned: Array, t: int) -> None:
    """The tip alone, into row t of place (T, 3) and turned (T, 3, 3): of all the slopes' slopes, the ends' remain."""
    n = x.shape[0] // 2 - 1
    speed, d1, d2, d3 = _speed(x, 0)
    passed, first = (0.5 * speed[0], 0.5 * speed[1], 0.5 * speed[2]), _bend(x, 0, d1, d2, d3)
    for j in range(1, n):
        speed, _, _, _ = _speed(x, j)
        passed = plus(passed, 1.0, speed)
    speed, d1, d2, d3 = _speed(x, n)
    at = _reached(passed, speed, first, _bend(x, n, d1, d2, d3), length / n)
    _write_axis(at, d1, d2, d3, centre, place, turned, t)


@leaf
def place_section(x: Array, length: float, centre: Array, at: float, place: Array, turned: Array, k: int) -> None:
    """The section at arc length `at`, into row k of place (S, 3) and turned (S, 3, 3)."""
    n = x.shape[0] // 2 - 1
    h = length / n
    last = min(max(int(at / h), 0), n - 1)
    speed, d1, d2, d3 = _speed(x, 0)
    passed, first, reached = (0.5 * speed[0], 0.5 * speed[1], 0.5 * speed[2]), _bend(x, 0, d1, d2, d3), (0.0, 0.0, 0.0)
    bend = first
    for j in range(1, last + 1):
        speed, d1, d2, d3 = _speed(x, j)
        bend = _bend(x, j, d1, d2, d3)
        reached = _reached(passed, speed, first, bend, h)
        passed = plus(passed, 1.0, speed)
    following, d1, d2, d3 = _speed(x, last + 1)
    t = at / h - last
    step = passed_between(speed, bend, following, _bend(x, last + 1, d1, d2, d3), t, h)
    d1, d2, d3 = rotation(
        orientation_between(
            (x[last, 12], x[last, 13], x[last, 14], x[last, 15]), (x[last, 3], x[last, 4], x[last, 5]),
            (x[last + 1, 12], x[last + 1, 13], x[last + 1, 14], x[last + 1, 15]),
            (x[last + 1, 3], x[last + 1, 4], x[last + 1, 5]), t, h,
        )
    )  # fmt: skip
    _write_axis(plus(reached, 1.0, step), d1, d2, d3, centre, place, turned, k)


@kernel
def motion(
    walls: Walls, arm: ArmArguments, state: MotionState, pressure: Array, pool: Array, tolerance: float, tips: TipPoses
) -> int:
    """Advance through the rows of pressure (T, N); fills the tips (T,).

    pool: a workspace, as `shooting.workspace_within` takes it. Returns the number of passes, or -1, having done
    nothing, where a pressure is not finite.
    """
    for t in range(pressure.shape[0]):
        for k in range(walls.actuators):
            if not abs(pressure[t, k]) < np.inf:
                return -1
    total, sections, workspace = (
        0,
        arm.stiffness.shape[0],
        workspace_within(pool, state.x.shape[0] // 2 - 1, state.branch_strains.shape[0]),
    )
    for t in range(pressure.shape[0]):
        r, q = t % sections, t % arm.rest.shape[0]
        if sections > 1:
            stiffen(arm.work, arm.stiffness[r])
        passes = advance(
            arm.work, walls, arm.rest[q], arm.per_pressure[r], arm.free_per_pa, state.before, pressure[t], arm.load,
            arm.loaded, arm.tip, arm.length, state.segments, arm.scale, state.coefficients, state.past_states, state.x,
            state.branch_factors, state.branch_strains, workspace, tolerance,
        )  # fmt: skip
        tips.good[t] = passes > 0
        if passes > 0:
            total += passes
        place_tip(state.x, arm.length, arm.centre, tips.place, tips.turned, t)
    return total


@kernel
def equilibria(
    walls: Walls,
    arms: ArmArguments,
    pressure: Array,
    workspace: Workspace,
    tolerance: float,
    tips: TipPoses,
    unstable: Array,
) -> None:
    """One equilibrium per row of pressure (B, N); fills the tips and unstable (B,).

    Each row has an arm of its own, or all have the first one; its section (stiffness, rest, per_pressure) the same.
    """
    for b in range(pressure.shape[0]):
        k, r, q = b % arms.work.shape[0], b % arms.stiffness.shape[0], b % arms.rest.shape[0]
        stiffen(arms.work[k], arms.stiffness[r])
        passes = equilibrium(
            arms.work[k], walls, arms.rest[q], arms.per_pressure[r], arms.free_per_pa[k], pressure[b], arms.load[k],
            arms.loaded, arms.tip[k], arms.length[k], arms.scale[k], workspace, tolerance,
        )  # fmt: skip
        tips.good[b], unstable[b] = passes > 0, passes == UNSTABLE
        if passes > 0:
            place_tip(workspace.x, arms.length[k], arms.centre[k], tips.place, tips.turned, b)
        else:
            tips.place[b] = np.nan
            tips.turned[b] = np.nan
