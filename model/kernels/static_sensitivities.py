"""The kernel of static sensitivities: equilibria, and the derivatives of tip and sections with respect to changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import (
    ArmArguments,
    Fields,
    LaneArguments,
    PressureWrench,
    Rod,
    SectionSensitivities,
    TipSensitivities,
)
from model.kernels.axis import write_section_pose, write_tip_pose
from model.kernels.equilibrium import UNSTABLE, equilibrium
from model.kernels.jit import kernel
from model.kernels.lanes import FIRST, SensitivityWorkspace, apply_pressure, apply_tip_load, section_poses, tip_poses
from model.kernels.law import Walls
from model.kernels.layout import LANES
from model.kernels.shooting import workspace_within
from model.kernels.tangents import tangents
from model.kernels.time_stepping import set_stiffness
from model.kernels.vec3 import leaf

Array = Any


@leaf
def _derivatives(works: Array, workspace: SensitivityWorkspace, steps: Array, by: Array) -> None:
    """Fill the derivatives (P, 6) of the poses in the workspace with respect to each change, of size steps (P,)."""
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            total = workspace.place[p, c, i] - workspace.place[0, c, 0]
            for k in range(6):
                total += workspace.shares[0, p, k, i] * (workspace.place[0, c, 1 + k] - workspace.place[0, c, 0])
            by[f, c] = total / steps[f]


@leaf
def _tip_derivatives(x: Array, works: Array, workspace: SensitivityWorkspace, steps: Array, by: Array) -> None:
    """Fill the derivatives (P, 6) of the pose of the tip, after `tangents`."""
    n = workspace.states.shape[2] - 1
    for p in range(works.shape[0]):
        tip_poses(works[p], workspace.states[0, p], workspace.derivatives[0, p], x[n], workspace.place[p])
    _derivatives(works, workspace, steps, by)


@leaf
def _section_derivatives(
    x: Array, length: float, works: Array, workspace: SensitivityWorkspace, steps: Array, at: Array, by: Array
) -> None:
    """Fill the same (S, P, 6) of the sections at arc lengths `at` (S,)."""
    for k in range(at.shape[0]):
        for p in range(works.shape[0]):
            section_poses(
                works[p], workspace.states[0, p], workspace.derivatives[0, p], at[k], length, x, workspace.place[p]
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
    row, tip_load = np.empty(walls.actuators), arm.tip.copy()
    segments = workspace.shares.shape[0]
    rod = Rod(arm.work, walls, arm.load, arm.loaded, tip_load, arm.length, arm.scale)
    for t in range(pressure.shape[0]):
        r, q = t % arm.stiffness.shape[0], t % arm.rest.shape[0]
        row_loads = tip_loads[t % tip_loads.shape[0]]
        apply_tip_load(arm.tip, row_loads, tip_load)
        for k in range(walls.actuators):
            row[k] = pressure[t, 0, k, 0]
        set_stiffness(arm.work, arm.stiffness[r])
        push = PressureWrench(arm.rest[q], arm.per_pressure[r], arm.free_per_pa)
        solved = equilibrium(rod, push, row, solver, tolerance)
        tips.good[t], tips.unstable[t] = solved > 0, solved == UNSTABLE
        if solved > 0:
            write_tip_pose(solver.x, arm.length, arm.centre, tips.place, tips.turned, t)
            for k in range(sections.at.shape[0]):
                write_section_pose(
                    solver.x, arm.length, arm.centre, sections.at[k], sections.place[t], sections.turned[t], k
                )
            if steps.shape[0] > 0:
                apply_pressure(lanes, walls.actuators, t, pressure[t], row_loads)
                if tangents(rod, lanes, 0.0, segments, solver.x, workspace, 0):
                    _tip_derivatives(solver.x, lanes.works, workspace, steps, tips.by[t])
                    _section_derivatives(
                        solver.x, arm.length, lanes.works, workspace, steps, sections.at, sections.by[t]
                    )
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
