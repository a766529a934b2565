"""The kernel of an arm in motion: its time steps, and how its tip answers to small changes of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import ArmArguments, LaneArguments, MotionState, SectionAnswers, TipAnswers
from model.kernels.axis import place_section, place_tip
from model.kernels.jit import kernel
from model.kernels.lanes import FIRST, Lanes, apply_pressure, apply_tip_load, places, section_places
from model.kernels.law import Walls, branched
from model.kernels.layout import LANES, STATE
from model.kernels.relaxation import relax_branches_in_lanes
from model.kernels.shooting import Workspace
from model.kernels.tangents import tangents
from model.kernels.time_stepping import advance, stiffen
from model.kernels.vec3 import inlined, leaf

Array = Any


@inlined
def _join(row: Array, first: Array, shares: Array, arm: Array, p: int, count: int, quantities: int) -> None:
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
def _combine(x: Array, segments: int, workspace: Lanes, states: Array, derivatives: Array) -> None:
    """Compute the perturbed solution in each lane from the tangents; lanes without one become the arm x."""
    n, count = states.shape[1] - 1, workspace.parts.shape[0]
    per = n // segments
    for j in range(n + 1):
        s = min(j // per, segments - 1)
        for p in range(states.shape[0] - 1, -1, -1):
            _join(states[p, j], states[0, j], workspace.shares[s, p], x[j], p, count, STATE)
            _join(derivatives[p, j], derivatives[0, j], workspace.shares[s, p], x[n + 1 + j], p, count, 12)


@leaf
def _moved(
    x: Array, works: Array, workspace: Lanes, states: Array, derivatives: Array, steps: Array, by: Array
) -> None:
    """How tip and turn answer (P, 6) to each neighbour's change, after `_combine`."""
    n = states.shape[1] - 1
    for p in range(works.shape[0]):
        places(works[p], states[p], derivatives[p], x[n], workspace.place[p])
    _answers(workspace, steps, by)


@leaf
def _answers(workspace: Lanes, steps: Array, by: Array) -> None:
    """Derivatives (P, 6) of the places in the workspace by each change of size steps (P,)."""
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            by[f, c] = (workspace.place[p, c, i] - workspace.place[0, c, 0]) / steps[f]


@leaf
def _sections_moved(
    x: Array, length: float, works: Array, workspace: Lanes, states: Array, derivatives: Array, steps: Array,
    at: Array, by: Array,
) -> None:  # fmt: skip
    """How the sections at arc lengths `at` (S,) answer (S, P, 6), after `_combine`."""
    for k in range(at.shape[0]):
        for p in range(works.shape[0]):
            section_places(works[p], states[p], derivatives[p], at[k], length, x, workspace.place[p])
        _answers(workspace, steps, by[k])


@leaf
def _update_history(past: Array, workspace: Lanes, last: int, a: float, b: float, d: float) -> None:
    """The history (eq 26) of the next time step: a, b times the last two solutions, d times this history."""
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
def _relax_branches(factors: Array, strains: Array, past: Array, workspace: Lanes, last: int) -> None:
    """The walls' past strains of the next time step, after `_update_history`."""
    for p in range(past.shape[0]):
        relax_branches_in_lanes(
            factors[p], strains[p], past[p], workspace.states[last, p], workspace.states[1 - last, p],
            workspace.derivatives[last, p], workspace.derivatives[1 - last, p],
        )  # fmt: skip


@kernel
def dynamic_sensitivities(
    walls: Walls,
    arm: ArmArguments,
    motion: MotionState,
    still: LaneArguments,
    still_scale: Array,
    swinging: LaneArguments,
    pressure: Array,
    tip_loads: Array,
    steps: Array,
    every: int,
    past: Array,
    branch_strains: Array,
    solver: Workspace,
    workspace: Lanes,
    tolerance: float,
    answers: TipAnswers,
    sections: SectionAnswers,
) -> None:
    """A motion from rest by BDF-alpha, and how its tip and sections answer to each neighbour's change.

    The arm stands at rest in the motion's x; `still` are the lanes of the arm at rest, `swinging` those of the moving
    one. pressure (1 + T, W, N, 8): at rest, then step by step; sections and tip_loads one for each of these rows, or
    one for all. past (W, N + 1, 192): for the lanes' history; (W, N + 1, 288) where the walls have branches, whose
    strains are branch_strains (W, B, N + 1, 96). steps (P,): sizes of the changes; without neighbours the lanes rest.
    Fills the answers (1 + T / every,) of every so many steps, and those of the sections.
    """
    row, here, x = np.empty(walls.actuators), arm.tip.copy(), motion.x
    scheme, segments = motion.coefficients, motion.segments
    c0, c1, c2, d1 = scheme[0], scheme[1], scheme[2], scheme[4]
    followed, now, rows = steps.shape[0] > 0, 0, arm.stiffness.shape[0]
    for t in range(pressure.shape[0]):
        r, q, tip_load = t % rows, t % arm.rest.shape[0], tip_loads[t % tip_loads.shape[0]]
        apply_tip_load(arm.tip, tip_load, here)
        solved = 1
        if t == 0 and followed:
            apply_pressure(
                still.works, walls.actuators, still.stiffness[0], still.rest[0], still.per_pressure[0], still.frees,
                still.ends, pressure[t], tip_load,
            )  # fmt: skip
            followed = tangents(
                still.works, walls, past, arm.load, still.loaded, 0.0, still.heavy, segments, still_scale, x, workspace,
                workspace.states[0], workspace.derivatives[0],
            )  # fmt: skip
            _combine(x, segments, workspace, workspace.states[0], workspace.derivatives[0])
            workspace.states[1] = workspace.states[0]
            workspace.derivatives[1] = workspace.derivatives[0]
            # An arm at rest has no rates: y^h = -c0 y.
            _update_history(past, workspace, now, -c0, 0.0, 0.0)
            if branched(walls.law):
                _relax_branches(swinging.branch_factors, branch_strains, past, workspace, now)
        if t > 0:
            for k in range(walls.actuators):
                row[k] = pressure[t, 0, k, 0]
            if rows > 1:
                stiffen(arm.work, arm.stiffness[r])
            solved = advance(
                arm.work, walls, arm.rest[q], arm.per_pressure[r], arm.free_per_pa, motion.before, row, arm.load,
                arm.loaded, here, arm.length, segments, arm.scale, scheme, motion.past_states, x,
                motion.branch_factors, motion.branch_strains, solver, tolerance,
            )  # fmt: skip
            if solved > 0 and followed:
                # y_t of the last step is c0 times its solution plus its history.
                _update_history(past, workspace, now, c1 + d1 * c0, c2, d1)
                if branched(walls.law):
                    _relax_branches(swinging.branch_factors, branch_strains, past, workspace, now)
                now = 1 - now
                apply_pressure(
                    swinging.works, walls.actuators, swinging.stiffness[r], swinging.rest[q], swinging.per_pressure[r],
                    swinging.frees, swinging.ends, pressure[t], tip_load,
                )  # fmt: skip
                followed = tangents(
                    swinging.works, walls, past, arm.load, swinging.loaded, c0, swinging.heavy, segments, arm.scale, x,
                    workspace, workspace.states[now], workspace.derivatives[now],
                )  # fmt: skip
                _combine(x, segments, workspace, workspace.states[now], workspace.derivatives[now])
        if t % every == 0:
            at = t // every
            answers.good[at] = solved > 0
            place_tip(x, arm.length, arm.centre, answers.place, answers.turned, at)
            for k in range(sections.at.shape[0]):
                place_section(x, arm.length, arm.centre, sections.at[k], sections.place[at], sections.turned[at], k)
            if followed:
                _moved(
                    x,
                    swinging.works,
                    workspace,
                    workspace.states[now],
                    workspace.derivatives[now],
                    steps,
                    answers.by[at],
                )
                _sections_moved(
                    x, arm.length, swinging.works, workspace, workspace.states[now], workspace.derivatives[now],
                    steps, sections.at, sections.by[at],
                )  # fmt: skip
            else:
                answers.by[at] = np.nan
                sections.by[at] = np.nan
