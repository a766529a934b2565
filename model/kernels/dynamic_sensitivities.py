"""The kernel of dynamic sensitivities: time steps, and the derivatives of tip and sections with respect to changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import (
    ArmArguments,
    Fields,
    LaneArguments,
    Line,
    MotionState,
    SectionSensitivities,
    TipSensitivities,
    push_of,
    rod_of,
)
from model.kernels.axis import write_section_pose, write_tip_pose
from model.kernels.jit import kernel
from model.kernels.lanes import SensitivityWorkspace, apply_pressure, apply_tip_load
from model.kernels.law import Walls, branched
from model.kernels.layout import LANES
from model.kernels.perturbed_solutions import perturbed_solutions, section_derivatives, tip_derivatives
from model.kernels.relaxation import relax_branch_lanes
from model.kernels.shooting import workspace_within
from model.kernels.tangents import tangents
from model.kernels.time_stepping import advance
from model.kernels.vec3 import leaf

Array = Any


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
def _relax_branches(
    line: Line, factors: Array, strains: Array, past: Array, workspace: SensitivityWorkspace, last: int
) -> None:
    """Update the past strains of the walls for the next time step, after `_update_history`."""
    for p in range(past.shape[0]):
        relax_branch_lanes(
            line, factors[p], strains[p], past[p], workspace.states[last, p], workspace.states[1 - last, p],
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
    row, ends, x = np.empty(pressure.shape[2]), arm.ends.copy(), state.x
    scheme, segments = state.coefficients, state.segments
    c0, c1, c2, d1 = scheme[0], scheme[1], scheme[2], scheme[4]
    differentiable, now = steps.shape[0] > 0, 0
    past, strains = workspace.past, workspace.branch_strains
    rod = rod_of(arm, walls, ends)
    for t in range(pressure.shape[0]):
        row_loads = tip_loads[t % tip_loads.shape[0]]
        apply_tip_load(arm.ends, row_loads, ends)
        solved = 1
        if t == 0 and differentiable:
            apply_pressure(at_rest, walls, arm.chambers, 0, pressure[t], row_loads)
            differentiable = tangents(rod, at_rest, 0.0, segments, x, workspace, 0)
            perturbed_solutions(x, segments, workspace, workspace.states[0], workspace.derivatives[0])
            workspace.states[1] = workspace.states[0]
            workspace.derivatives[1] = workspace.derivatives[0]
            # An arm at rest has no rates: y^h = -c0 y.
            _update_history(past, workspace, now, -c0, 0.0, 0.0)
            if branched(walls.law):
                _relax_branches(rod.line, moving.branch_factors, strains, past, workspace, now)
        if t > 0:
            for k in range(pressure.shape[2]):
                row[k] = pressure[t, 0, k, 0]
            solved = advance(rod, push_of(arm, t), state, row, solver, tolerance)
            if solved > 0 and differentiable:
                # y_t of the last step is c0 times its solution plus its history.
                _update_history(past, workspace, now, c1 + d1 * c0, c2, d1)
                if branched(walls.law):
                    _relax_branches(rod.line, moving.branch_factors, strains, past, workspace, now)
                now = 1 - now
                apply_pressure(moving, walls, arm.chambers, t, pressure[t], row_loads)
                differentiable = tangents(rod, moving, c0, segments, x, workspace, now)
                perturbed_solutions(x, segments, workspace, workspace.states[now], workspace.derivatives[now])
        if t % every == 0:
            at = t // every
            tips.good[at] = solved > 0
            write_tip_pose(x, rod.line, tips.place, tips.turned, at)
            for k in range(sections.at.shape[0]):
                write_section_pose(x, rod.line, sections.at[k], sections.place[at], sections.turned[at], k)
            if differentiable:
                tip_derivatives(
                    x,
                    moving.works,
                    rod.line,
                    workspace,
                    workspace.states[now],
                    workspace.derivatives[now],
                    steps,
                    tips.by[at],
                )
                section_derivatives(
                    x, moving.works, rod.line, workspace, workspace.states[now], workspace.derivatives[now],
                    steps, sections.at, sections.by[at],
                )  # fmt: skip
            else:
                tips.by[at] = np.nan
                sections.by[at] = np.nan
