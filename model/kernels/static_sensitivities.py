"""The kernel of arms at rest: their equilibria, and how their tips answer to small changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import ArmArguments, LaneArguments, SectionAnswers, TipAnswers
from model.kernels.axis import place_section, place_tip
from model.kernels.equilibrium import UNSTABLE, equilibrium
from model.kernels.jit import kernel
from model.kernels.lanes import FIRST, Lanes, apply_pressure, apply_tip_load, places, section_places
from model.kernels.law import Walls
from model.kernels.layout import LANES
from model.kernels.shooting import Workspace
from model.kernels.tangents import tangents
from model.kernels.time_stepping import stiffen
from model.kernels.vec3 import leaf

Array = Any


@leaf
def _answers(works: Array, workspace: Lanes, steps: Array, by: Array) -> None:
    """Derivatives (P, 6) of places and rotations by each change of size steps (P,), of the places in the workspace."""
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            total = workspace.place[p, c, i] - workspace.place[0, c, 0]
            for k in range(6):
                total += workspace.shares[0, p, k, i] * (workspace.place[0, c, 1 + k] - workspace.place[0, c, 0])
            by[f, c] = total / steps[f]


@leaf
def _tip_answers(x: Array, works: Array, workspace: Lanes, steps: Array, by: Array) -> None:
    """Derivatives (P, 6) of tip and rotation, after the tangents are solved."""
    n = workspace.states.shape[2] - 1
    for p in range(works.shape[0]):
        places(works[p], workspace.states[0, p], workspace.derivatives[0, p], x[n], workspace.place[p])
    _answers(works, workspace, steps, by)


@leaf
def _section_answers(
    x: Array, length: float, works: Array, workspace: Lanes, steps: Array, at: Array, by: Array
) -> None:
    """The same (S, P, 6) of the sections at arc lengths `at` (S,)."""
    for k in range(at.shape[0]):
        for p in range(works.shape[0]):
            section_places(
                works[p], workspace.states[0, p], workspace.derivatives[0, p], at[k], length, x, workspace.place[p]
            )
        _answers(works, workspace, steps, by[k])


@kernel
def static_sensitivities(
    walls: Walls,
    arm: ArmArguments,
    lanes: LaneArguments,
    pressure: Array,
    tip_loads: Array,
    steps: Array,
    solver: Workspace,
    workspace: Lanes,
    tolerance: float,
    answers: TipAnswers,
    sections: SectionAnswers,
) -> None:
    """One equilibrium per row of pressure (K, W, N, 8); how its tip and sections answer to each neighbour's change.

    tip_loads (K, W, 12, 8): what hangs on the lanes' tips beyond the cap, one for each row or for all. steps (P,):
    sizes of the changes. Fills the answers and those of the sections.
    """
    row, here = np.empty(walls.actuators), arm.tip.copy()
    nothing = np.zeros((lanes.works.shape[0], 1, 1))
    segments = workspace.shares.shape[0]
    for t in range(pressure.shape[0]):
        r, q = t % arm.stiffness.shape[0], t % arm.rest.shape[0]
        tip_load = tip_loads[t % tip_loads.shape[0]]
        apply_tip_load(arm.tip, tip_load, here)
        for k in range(walls.actuators):
            row[k] = pressure[t, 0, k, 0]
        stiffen(arm.work, arm.stiffness[r])
        solved = equilibrium(
            arm.work, walls, arm.rest[q], arm.per_pressure[r], arm.free_per_pa, row, arm.load, arm.loaded, here,
            arm.length, arm.scale, solver, tolerance,
        )  # fmt: skip
        answers.good[t], answers.unstable[t] = solved > 0, solved == UNSTABLE
        if solved > 0:
            place_tip(solver.x, arm.length, arm.centre, answers.place, answers.turned, t)
            for k in range(sections.at.shape[0]):
                place_section(
                    solver.x, arm.length, arm.centre, sections.at[k], sections.place[t], sections.turned[t], k
                )
            if steps.shape[0] > 0:
                apply_pressure(
                    lanes.works, walls.actuators, lanes.stiffness[r], lanes.rest[q], lanes.per_pressure[r], lanes.frees,
                    lanes.ends, pressure[t], tip_load,
                )  # fmt: skip
                found = tangents(
                    lanes.works, walls, nothing, arm.load, lanes.loaded, 0.0, lanes.heavy, segments, arm.scale,
                    solver.x, workspace, workspace.states[0], workspace.derivatives[0],
                )  # fmt: skip
                if found:
                    _tip_answers(solver.x, lanes.works, workspace, steps, answers.by[t])
                    _section_answers(solver.x, arm.length, lanes.works, workspace, steps, sections.at, sections.by[t])
                else:
                    answers.by[t] = np.nan
                    sections.by[t] = np.nan
        else:
            answers.place[t] = np.nan
            answers.turned[t] = np.nan
            answers.by[t] = np.nan
            sections.place[t] = np.nan
            sections.turned[t] = np.nan
            sections.by[t] = np.nan
