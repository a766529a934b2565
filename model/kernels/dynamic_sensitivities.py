"""The kernel of dynamic sensitivities: time steps, and the derivatives of tip and sections with respect to changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import (
    ArmArguments,
    Fields,
    LaneArguments,
    MotionState,
    PressureWrench,
    Rod,
    SectionSensitivities,
    TipSensitivities,
)
from model.kernels.axis import write_section_pose, write_tip_pose
from model.kernels.jit import kernel
from model.kernels.lanes import FIRST, SensitivityWorkspace, apply_pressure, apply_tip_load, section_poses, tip_poses
from model.kernels.law import Walls, branched
from model.kernels.layout import LANES, STATE
from model.kernels.relaxation import relax_branch_lanes
from model.kernels.shooting import workspace_within
from model.kernels.tangents import tangents
from model.kernels.time_stepping import advance, set_stiffness
from model.kernels.vec3 import inlined, leaf

Array = Any


@inlined
def _combine_row(row: Array, first: Array, shares: Array, arm: Array, p: int, count: int, quantities: int) -> None:
    for c in range(quantities):
        at = c * LANES
        base = first[at]
        d1, d2, d3 = first[at + 1] - base, first[at + 2] - base, first[at + 3] - base
        d4, d5, d6 = first[at + 4] - base, first[at + 5] - base, first[at + 6] - base
        for i in range(LANES):
            total = row[at + i] - base + shares[0, i] * d1 + shares[1, i] * d2 + shares[2, i] * d3
            row[at + i] = arm[c] + total + shares[3, i] * d4 + shares[4, i] * d5 + shares[5, i] * d6
        for i in range(LANES):
            lane = p * LANES + i
            if lane < FIRST or lane >= FIRST + count:
                row[at + i] = arm[c]


@leaf
def _perturbed_solutions(
    x: Array, segments: int, workspace: SensitivityWorkspace, states: Array, derivatives: Array
) -> None:
    """Turn the tangent vectors into the perturbed solution of each lane; lanes without a copy take the solution x."""
    n, count = states.shape[1] - 1, workspace.parts.shape[0]
    per = n // segments
    for j in range(n + 1):
        s = min(j // per, segments - 1)
        for p in range(states.shape[0] - 1, -1, -1):
            _combine_row(states[p, j], states[0, j], workspace.shares[s, p], x[j], p, count, STATE)
            _combine_row(derivatives[p, j], derivatives[0, j], workspace.shares[s, p], x[n + 1 + j], p, count, 12)


@leaf
def _tip_derivatives(
    x: Array, works: Array, workspace: SensitivityWorkspace, states: Array, derivatives: Array, steps: Array, by: Array
) -> None:
    """Fill the derivatives (P, 6) of the pose of the tip, after `_perturbed_solutions`."""
    n = states.shape[1] - 1
    for p in range(works.shape[0]):
        tip_poses(works[p], states[p], derivatives[p], x[n], workspace.place[p])
    _derivatives(workspace, steps, by)


@leaf
def _derivatives(workspace: SensitivityWorkspace, steps: Array, by: Array) -> None:
    """Derivatives (P, 6) of the tip_poses in the workspace by each change of size steps (P,)."""
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            by[f, c] = (workspace.place[p, c, i] - workspace.place[0, c, 0]) / steps[f]


@leaf
def _section_derivatives(
    x: Array, length: float, works: Array, workspace: SensitivityWorkspace, states: Array, derivatives: Array,
    steps: Array, at: Array, by: Array,
) -> None:  # fmt: skip
    """Fill the same (S, P, 6) of the sections at arc lengths `at` (S,)."""
    for k in range(at.shape[0]):
        for p in range(works.shape[0]):
            section_poses(works[p], states[p], derivatives[p], at[k], length, x, workspace.place[p])
        _derivatives(workspace, steps, by[k])


@leaf
def _update_history(past: Array, workspace: SensitivityWorkspace, last: int, a: float, b: float, d: float) -> None:
    """Update the history y^h (eq 26) for the next step: a, b times the last two solutions plus d times the history."""
    half = 12 * LANES
    for k in range(past.shape[0]):
        for j in range(past.shape[1]):
            x, x_before = workspace.states[last, k, j], workspace.states[1 - last, k, j]
            slope, slope_before = workspace.derivatives[last, k, j], workspace.derivatives[1 - last, k, j]
            for i in range(half):
                past[k, j, i] = a * x[i] + b * x_before[i] + d * past[k, j, i]
            for i in range(half):
                past[k, j, half + i] = a * slope[i] + b * slope_before[i] + d * past[k, j, half + i]


@leaf
def _relax_branches(factors: Array, strains: Array, past: Array, workspace: SensitivityWorkspace, last: int) -> None:
    """Update the past strains of the walls for the next time step, after `_update_history`."""
    for p in range(past.shape[0]):
        relax_branch_lanes(
            factors[p], strains[p], past[p], workspace.states[last, p], workspace.states[1 - last, p],
            workspace.derivatives[last, p], workspace.derivatives[1 - last, p],
        )  # fmt: skip


@kernel
def dynamic_sensitivities(
    walls: Walls,
    arm_fields: Fields,
    state_fields: Fields,
    static_lane_fields: Fields,
    dynamic_lane_fields: Fields,
    pressure: Array,
    tip_loads: Array,
    steps: Array,
    every: int,
    pool: Array,
    workspace_fields: Fields,
    tolerance: float,
    tip_fields: Fields,
    section_fields: Fields,
) -> None:
    """Integrate a motion from rest by BDF-alpha, and differentiate its tip and sections.

    state: at rest in its x. static_lanes, dynamic_lanes: of the arm at rest and in motion. pressure (1 + T, W, N, 8)
    [Pa]: at rest, then for each time step; sections and tip_loads: one for each of these rows, or one for all. steps
    (P,): sizes of the changes. Fills poses and derivatives (1 + T / every,) of tip and sections.
    """
    arm, state = ArmArguments(*arm_fields), MotionState(*state_fields)
    solver = workspace_within(pool, state.x.shape[0] // 2 - 1, state.branch_strains.shape[0])
    at_rest, moving = LaneArguments(*static_lane_fields), LaneArguments(*dynamic_lane_fields)
    workspace, tips = SensitivityWorkspace(*workspace_fields), TipSensitivities(*tip_fields)
    sections = SectionSensitivities(*section_fields)
    row, tip_load, x = np.empty(walls.actuators), arm.tip.copy(), state.x
    scheme, segments = state.coefficients, state.segments
    c0, c1, c2, d1 = scheme[0], scheme[1], scheme[2], scheme[4]
    differentiable, now, rows = steps.shape[0] > 0, 0, arm.stiffness.shape[0]
    past, strains = workspace.past, workspace.branch_strains
    rod = Rod(arm.work, walls, arm.load, arm.loaded, tip_load, arm.length, arm.scale)
    for t in range(pressure.shape[0]):
        r, q, row_loads = t % rows, t % arm.rest.shape[0], tip_loads[t % tip_loads.shape[0]]
        apply_tip_load(arm.tip, row_loads, tip_load)
        solved = 1
        if t == 0 and differentiable:
            apply_pressure(at_rest, walls.actuators, 0, pressure[t], row_loads)
            differentiable = tangents(rod, at_rest, 0.0, segments, x, workspace, 0)
            _perturbed_solutions(x, segments, workspace, workspace.states[0], workspace.derivatives[0])
            workspace.states[1] = workspace.states[0]
            workspace.derivatives[1] = workspace.derivatives[0]
            # An arm at rest has no rates: y^h = -c0 y.
            _update_history(past, workspace, now, -c0, 0.0, 0.0)
            if branched(walls.law):
                _relax_branches(moving.branch_factors, strains, past, workspace, now)
        if t > 0:
            for k in range(walls.actuators):
                row[k] = pressure[t, 0, k, 0]
            if rows > 1:
                set_stiffness(arm.work, arm.stiffness[r])
            push = PressureWrench(arm.rest[q], arm.per_pressure[r], arm.free_per_pa)
            solved = advance(rod, push, state, row, solver, tolerance)
            if solved > 0 and differentiable:
                # y_t of the last step is c0 times its solution plus its history.
                _update_history(past, workspace, now, c1 + d1 * c0, c2, d1)
                if branched(walls.law):
                    _relax_branches(moving.branch_factors, strains, past, workspace, now)
                now = 1 - now
                apply_pressure(moving, walls.actuators, t, pressure[t], row_loads)
                differentiable = tangents(rod, moving, c0, segments, x, workspace, now)
                _perturbed_solutions(x, segments, workspace, workspace.states[now], workspace.derivatives[now])
        if t % every == 0:
            at = t // every
            tips.good[at] = solved > 0
            write_tip_pose(x, arm.length, arm.centre, tips.place, tips.turned, at)
            for k in range(sections.at.shape[0]):
                write_section_pose(
                    x, arm.length, arm.centre, sections.at[k], sections.place[at], sections.turned[at], k
                )
            if differentiable:
                _tip_derivatives(
                    x,
                    moving.works,
                    workspace,
                    workspace.states[now],
                    workspace.derivatives[now],
                    steps,
                    tips.by[at],
                )
                _section_derivatives(
                    x, arm.length, moving.works, workspace, workspace.states[now], workspace.derivatives[now],
                    steps, sections.at, sections.by[at],
                )  # fmt: skip
            else:
                tips.by[at] = np.nan
                sections.by[at] = np.nan
