"""Tangent vectors of the solved boundary value problem, in one integration of all lanes.

By the implicit function theorem: a copy of the arm with a perturbed parameter, pressure, load or history is integrated
from the base strains of the solution. The base strains that cancel its residual at the tip follow from the Jacobian by
the perturbed base strains, so no further Newton iteration is needed.
"""

from __future__ import annotations

from typing import Any

from model.kernels.lanes import FIRST, UNUSED_HISTORY, SensitivityWorkspace, integrate_lanes
from model.kernels.law import Walls
from model.kernels.layout import LANES, NODE, STATE, WRENCH
from model.kernels.linear_algebra import orthonormalise, solve_six_rows
from model.kernels.shooting import tip_residual
from model.kernels.vec3 import leaf

Array = Any

STEP = 1e-7  # of the perturbed base strains, in scaled states


@leaf
def tangents(
    works: Array, walls: Walls, past: Array, load: Array, loaded: bool, c0: float, cap_inertia: bool,
    segments: int, scale: Array, x: Array, workspace: SensitivityWorkspace, states: Array, derivatives: Array,
) -> bool:  # fmt: skip
    """Integrate all lanes along the solved arm x (2 N + 2, 16): fills states, derivatives (W, N + 1, 128) and shares.

    The solution of a copy in segment s is its lane plus its shares of lanes 1 to 6, all relative to lane 0. Segments
    are joined as in `shooting.newton`. past (W, N + 1, 192 or 288) is not read for an arm at rest. Returns False if the
    Jacobian is singular.
    """
    directions, triangle, projections, parts = (
        workspace.directions,
        workspace.triangle,
        workspace.projections,
        workspace.parts,
    )
    n, count = states.shape[1] - 1, parts.shape[0]
    per = n // segments
    first = works[0]
    for k in range(6):
        for c in range(STATE):
            directions[0, k, c] = 1.0 if c == k else 0.0
    for f in range(count):
        for c in range(STATE):
            parts[f, c] = 0.0
    for s in range(segments):
        for p in range(works.shape[0]):
            w = works[p]
            for c in range(STATE):
                at = (NODE + c) * LANES
                for i in range(LANES):
                    w[at + i] = x[s * per, c]
                for i in range(LANES):
                    f = p * LANES + i - FIRST
                    if 0 <= f < count:
                        w[at + i] += parts[f, c]
                if p == 0:
                    for k in range(6):
                        w[at + 1 + k] += STEP * scale[c] * directions[s, k, c]
            integrate_lanes(
                w, walls, past[p], c0 > 0.0, load, loaded, s * per, (s + 1) * per, states[p], derivatives[p]
            )  # fmt: skip
        if s == segments - 1:
            break
        for c in range(STATE):
            at, over = (NODE + c) * LANES, 1.0 / (STEP * scale[c])
            for k in range(6):
                directions[s + 1, k, c] = (first[at + 1 + k] - first[at]) * over
        if not orthonormalise(directions[s + 1], triangle[s + 1]):
            return False
        for f in range(count):
            w, i = works[(FIRST + f) // LANES], (FIRST + f) % LANES
            for c in range(STATE):
                at = (NODE + c) * LANES
                parts[f, c] = (w[at + i] - first[at]) / scale[c]
            for k in range(6):
                total = 0.0
                for c in range(STATE):
                    total += directions[s + 1, k, c] * parts[f, c]
                projections[s + 1, f, k] = total
            for k in range(6):
                for c in range(STATE):
                    parts[f, c] -= projections[s + 1, f, k] * directions[s + 1, k, c]
            for c in range(STATE):
                parts[f, c] *= scale[c]
    for p in range(works.shape[0]):
        tip_residual(works[p], walls, UNUSED_HISTORY, True, c0, cap_inertia)
    for i in range(6):
        at = (WRENCH + i) * LANES
        for k in range(6):
            workspace.matrix[i, k] = (first[at + 1 + k] - first[at]) * (1.0 / STEP)
        for f in range(count):
            lane = FIRST + f
            workspace.right[f, i] = first[at] - works[lane // LANES, at + lane % LANES]
    if not solve_six_rows(workspace.matrix, workspace.right):
        return False
    for f in range(count):
        p, i, right = (FIRST + f) // LANES, (FIRST + f) % LANES, workspace.right[f]
        for s in range(segments - 1, -1, -1):
            for k in range(6):
                workspace.shares[s, p, k, i] = right[k] * (1.0 / STEP)
            if s > 0:
                for k in range(5, -1, -1):
                    total = right[k] - projections[s, f, k]
                    for c in range(k + 1, 6):
                        total -= triangle[s, k, c] * right[c]
                    right[k] = total / triangle[s, k, k]
    return True
