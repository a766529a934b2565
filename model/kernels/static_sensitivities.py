"""The kernel of static sensitivities: equilibria, and the derivatives of tip and sections with respect to changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import (
    ArmArguments,
    Fields,
    LaneArguments,
    Line,
    SectionSensitivities,
    TipSensitivities,
    push_of,
    rod_of,
)
from model.kernels.axis import write_section_pose, write_tip_pose
from model.kernels.equilibrium import UNSTABLE, equilibrium
from model.kernels.jit import kernel
from model.kernels.lanes import FIRST, SensitivityWorkspace, apply_pressure, apply_tip_load, section_poses, tip_poses
from model.kernels.law import Walls
from model.kernels.layout import LANES
from model.kernels.perturbed_solutions import perturbed_solutions, section_derivatives, tip_derivatives
from model.kernels.shooting import workspace_within
from model.kernels.tangents import tangents
from model.kernels.vec3 import leaf

Array = Any


@leaf
def _derivatives(works: Array, workspace: SensitivityWorkspace, steps: Array, by: Array) -> None:
    """Fill the derivatives (P, 6) of the poses in the workspace by each change of size steps (P,), one segment."""
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            total = workspace.place[p, c, i] - workspace.place[0, c, 0]
            for k in range(6):
                total += workspace.shares[0, p, k, i] * (workspace.place[0, c, 1 + k] - workspace.place[0, c, 0])
            by[f, c] = total / steps[f]


@leaf
def _tip_derivatives(
    x: Array, works: Array, line: Line, workspace: SensitivityWorkspace, steps: Array, by: Array
) -> None:
    """Fill the derivatives (P, 6) of the pose of the tip, after `tangents`."""
    n = workspace.states.shape[2] - 1
    for p in range(works.shape[0]):
        tip_poses(works[p], line, workspace.states[0, p], workspace.derivatives[0, p], x[n], workspace.place[p])
    _derivatives(works, workspace, steps, by)


@leaf
def _section_derivatives(
    x: Array, works: Array, line: Line, workspace: SensitivityWorkspace, steps: Array, at: Array, by: Array
) -> None:
    """Fill the same (S, P, 6) of the sections at arc lengths `at` (S,)."""
    for k in range(at.shape[0]):
        for p in range(works.shape[0]):
            section_poses(
                works[p], line, workspace.states[0, p], workspace.derivatives[0, p], at[k], x, workspace.place[p]
            )
        _derivatives(works, workspace, steps, by[k])


@kernel
def static_sensitivities(
    walls: Walls,
    arm_fields: Fields,
    lane_fields: Fields,
    pressure: Array,
    tip_loads: Array,
    steps: Array,
    pool: Array,
    workspace_fields: Fields,
    tolerance: float,
    tip_fields: Fields,
    section_fields: Fields,
) -> None:
    """Solve one equilibrium for each row of pressure (K, W, N, 8) [Pa], and differentiate its tip and sections.

    tip_loads (K or 1, W, 12, 8): loads at the tips beyond those of the cap, as of `lanes.apply_pressure`. steps (P,):
    sizes of the changes. Fills the poses and derivatives of tip and sections, NaN where no stable solution is found.
    """
    arm, lanes = ArmArguments(*arm_fields), LaneArguments(*lane_fields)
    solver = workspace_within(pool, arm.load.shape[0] // 12, 0)
    workspace, tips = SensitivityWorkspace(*workspace_fields), TipSensitivities(*tip_fields)
    sections = SectionSensitivities(*section_fields)
    row, ends = np.empty(pressure.shape[2]), arm.ends.copy()
    segments = workspace.shares.shape[0]
    rod = rod_of(arm, walls, ends)
    for t in range(pressure.shape[0]):
        row_loads = tip_loads[t % tip_loads.shape[0]]
        apply_tip_load(arm.ends, row_loads, ends)
        for k in range(pressure.shape[2]):
            row[k] = pressure[t, 0, k, 0]
        solved = equilibrium(rod, push_of(arm, t), row, solver, tolerance)
        tips.good[t], tips.unstable[t] = solved > 0, solved == UNSTABLE
        if solved > 0:
            write_tip_pose(solver.x, rod.line, tips.place, tips.turned, t)
            for k in range(sections.at.shape[0]):
                write_section_pose(solver.x, rod.line, sections.at[k], sections.place[t], sections.turned[t], k)
            if steps.shape[0] > 0:
                apply_pressure(lanes, walls, arm.chambers, t, pressure[t], row_loads)
                differentiable = tangents(rod, lanes, 0.0, segments, solver.x, workspace, 0)
                if differentiable and segments > 1:
                    states, derivatives = workspace.states[0], workspace.derivatives[0]
                    perturbed_solutions(solver.x, segments, workspace, states, derivatives)
                    tip_derivatives(solver.x, lanes.works, rod.line, workspace, states, derivatives, steps, tips.by[t])
                    section_derivatives(
                        solver.x, lanes.works, rod.line, workspace, states, derivatives, steps, sections.at,
                        sections.by[t],
                    )  # fmt: skip
                elif differentiable:
                    _tip_derivatives(solver.x, lanes.works, rod.line, workspace, steps, tips.by[t])
                    _section_derivatives(solver.x, lanes.works, rod.line, workspace, steps, sections.at, sections.by[t])
                else:
                    tips.by[t] = np.nan
                    sections.by[t] = np.nan
        else:
            tips.place[t] = np.nan
            tips.turned[t] = np.nan
            tips.by[t] = np.nan
            sections.place[t] = np.nan
            sections.turned[t] = np.nan
            sections.by[t] = np.nan
