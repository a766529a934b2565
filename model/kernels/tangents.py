"""The kernel that finds an arm's neighbours from its solution, in one pass over the lanes.

By the implicit function theorem. A neighbour is the same arm but for a parameter, a pressure, a load or a past. What
its tip lacks is made good along the moved base strains, so no further Newton iterations are needed.
"""

from __future__ import annotations

from typing import Any

from model.kernels.lanes import FIRST, OWN, Lanes, integrate_lanes
from model.kernels.law import Walls
from model.kernels.layout import LANES, NODE, STATE, WRENCH
from model.kernels.linear_algebra import orthonormalise, solve_six_rows
from model.kernels.shooting import tip_residual
from model.kernels.vec3 import leaf

Array = Any

STEP = 1e-7  # of the moved base strains, in scaled states


@leaf
def tangents(
    works: Array, walls: Walls, past: Array, load: Array, loaded: bool, c0: float, heavy: bool,
    segments: int, scale: Array, x: Array, workspace: Lanes, states: Array, derivatives: Array,
) -> bool:  # fmt: skip
    """One pass from the solved arm x (2 N + 2, 16): fills states, derivatives (W, N + 1, 128) and the shares of them.

    A neighbour is its lane plus, in segment s, its shares of lanes 1 to 6, all against lane 0. Segments are joined as
    in `shooting.newton`. past (W, N + 1, 192 or 288), at rest not looked at. False when no answer is found.
    """
    directions, triangle, along, parts = workspace.directions, workspace.triangle, workspace.along, workspace.parts
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
                along[s + 1, f, k] = total
            for k in range(6):
                for c in range(STATE):
                    parts[f, c] -= along[s + 1, f, k] * directions[s + 1, k, c]
            for c in range(STATE):
                parts[f, c] *= scale[c]
    for p in range(works.shape[0]):
        tip_residual(works[p], walls, OWN, True, c0, heavy)
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
                    total = right[k] - along[s, f, k]
                    for c in range(k + 1, 6):
                        total -= triangle[s, k, c] * right[c]
                    right[k] = total / triangle[s, k, k]
    return True
