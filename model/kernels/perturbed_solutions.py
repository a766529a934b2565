"""The perturbed solutions of all lanes, and the derivatives of tip and sections that follow from them."""

from __future__ import annotations

from typing import Any

from model.kernels.arguments import Line
from model.kernels.lanes import FIRST, SensitivityWorkspace, section_poses, tip_poses
from model.kernels.layout import LANES, STATE
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
def perturbed_solutions(
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
def tip_derivatives(
    x: Array, works: Array, line: Line, workspace: SensitivityWorkspace, states: Array, derivatives: Array,
    steps: Array, by: Array,
) -> None:  # fmt: skip
    """Fill the derivatives (P, 6) of the pose of the tip, after `perturbed_solutions`."""
    n = states.shape[1] - 1
    for p in range(works.shape[0]):
        tip_poses(works[p], line, states[p], derivatives[p], x[n], workspace.place[p])
    _derivatives(workspace, steps, by)


@leaf
def _derivatives(workspace: SensitivityWorkspace, steps: Array, by: Array) -> None:
    """Derivatives (P, 6) of the tip_poses in the workspace by each change of size steps (P,)."""
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            by[f, c] = (workspace.place[p, c, i] - workspace.place[0, c, 0]) / steps[f]


@leaf
def section_derivatives(
    x: Array, works: Array, line: Line, workspace: SensitivityWorkspace, states: Array, derivatives: Array,
    steps: Array, at: Array, by: Array,
) -> None:  # fmt: skip
    """Fill the same (S, P, 6) of the sections at arc lengths `at` (S,)."""
    for k in range(at.shape[0]):
        for p in range(works.shape[0]):
            section_poses(works[p], line, states[p], derivatives[p], at[k], x, workspace.place[p])
        _derivatives(workspace, steps, by[k])
