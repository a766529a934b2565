"""Tangent vectors of the solved boundary value problem, in one integration of all lanes.

By the implicit function theorem: a copy of the arm with a perturbed parameter, pressure, load or history is integrated
from the base strains of the solution. The base strains that cancel its residual at the tip follow from the Jacobian by
the perturbed base strains, so no further Newton iteration is needed.
"""

from __future__ import annotations

from typing import Any

from model.kernels.arguments import LaneArguments, Rod, segment_at
from model.kernels.integration import UNUSED_HISTORY, integrate_lanes
from model.kernels.joints import end_wrench
from model.kernels.lanes import FIRST, SensitivityWorkspace
from model.kernels.layout import LANES, NODE, STATE, WRENCH
from model.kernels.linear_algebra import orthonormalise, solve_six_rows
from model.kernels.vec3 import inlined, leaf

Array = Any

STEP = 1e-7  # of the perturbed base strains, in scaled states


@inlined
def _clear_first_segment(workspace: SensitivityWorkspace) -> None:
    """The directions of the first segment are the base strains; the copies start from the solution."""
    directions, parts = workspace.directions, workspace.parts
    for k in range(6):
        for c in range(STATE):
            directions[0, k, c] = 1.0 if c == k else 0.0
    for f in range(parts.shape[0]):
        for c in range(STATE):
            parts[f, c] = 0.0


@inlined
def _start_segment(w: Array, p: int, start: Array, scale: Array, workspace: SensitivityWorkspace, s: int) -> None:
    """Set the lanes of work array p at the start of segment s, where the solved rod has the state `start` (16,)."""
    directions, parts = workspace.directions, workspace.parts
    count = parts.shape[0]
    for c in range(STATE):
        at = (NODE + c) * LANES
        for i in range(LANES):
            w[at + i] = start[c]
        for i in range(LANES):
            f = p * LANES + i - FIRST
            if 0 <= f < count:
                w[at + i] += parts[f, c]
        if p == 0:
            for k in range(6):
                w[at + 1 + k] += STEP * scale[c] * directions[s, k, c]


@inlined
def _carry_segment(works: Array, own: int, scale: Array, workspace: SensitivityWorkspace, s: int) -> bool:
    """Directions and parts at the start of shooting segment s + 1, in segment `own` of the arm; False if dependent."""
    directions, projections, parts, first = workspace.directions, workspace.projections, workspace.parts, works[0, own]
    for c in range(STATE):
        at, over = (NODE + c) * LANES, 1.0 / (STEP * scale[c])
        for k in range(6):
            directions[s + 1, k, c] = (first[at + 1 + k] - first[at]) * over
    if not orthonormalise(directions[s + 1], workspace.triangle[s + 1]):
        return False
    for f in range(parts.shape[0]):
        w, i = works[(FIRST + f) // LANES, own], (FIRST + f) % LANES
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
    return True


@inlined
def _solve_tip(works: Array, workspace: SensitivityWorkspace) -> bool:
    """Solve for the shares of the last segment, in workspace.right (P, 6); False if the Jacobian is singular."""
    tip = works.shape[1] - 1
    first = works[0, tip]
    for i in range(6):
        at = (WRENCH + i) * LANES
        for k in range(6):
            workspace.matrix[i, k] = (first[at + 1 + k] - first[at]) * (1.0 / STEP)
        for f in range(workspace.parts.shape[0]):
            lane = FIRST + f
            workspace.right[f, i] = first[at] - works[lane // LANES, tip, at + lane % LANES]
    return solve_six_rows(workspace.matrix, workspace.right)  # type: ignore[no-any-return]


@inlined
def _fill_shares(workspace: SensitivityWorkspace, last: int) -> None:
    """Shares of every segment, by back substitution from the last to the first."""
    projections, triangle = workspace.projections, workspace.triangle
    for f in range(workspace.parts.shape[0]):
        p, i, right = (FIRST + f) // LANES, (FIRST + f) % LANES, workspace.right[f]
        for s in range(last, -1, -1):
            for k in range(6):
                workspace.shares[s, p, k, i] = right[k] * (1.0 / STEP)
            if s > 0:
                for k in range(5, -1, -1):
                    total = right[k] - projections[s, f, k]
                    for c in range(k + 1, 6):
                        total -= triangle[s, k, c] * right[c]
                    right[k] = total / triangle[s, k, k]


@leaf
def tangents(
    rod: Rod, lanes: LaneArguments, c0: float, segments: int, x: Array, workspace: SensitivityWorkspace, now: int
) -> bool:
    """Integrate all lanes along the solved rod x (2 N + 2, 16): fills states and derivatives at `now`, and shares.

    The solution of a copy in segment s is its lane plus its shares of lanes 1 to 6, all relative to lane 0. Segments
    are joined as in `shooting.newton`. The past of the lanes is not read for an arm at rest, whose c0 is zero. Returns
    False if the Jacobian is singular.
    """
    states, derivatives, last, line = workspace.states[now], workspace.derivatives[now], segments - 1, rod.line
    per = (states.shape[1] - 1) // segments
    _clear_first_segment(workspace)
    for s in range(segments):
        for p in range(lanes.works.shape[0]):
            start, end = s * per, (s + 1) * per
            _start_segment(lanes.works[p, segment_at(line, start)], p, x[start], lanes.scale, workspace, s)
            copies = Rod(lanes.works[p], rod.walls, rod.load, lanes.loaded, rod.ends, rod.length, lanes.scale, rod.line)
            integrate_lanes(
                copies, workspace.past[p], c0 > 0.0, start, end, states[p], derivatives[p], x, lanes.inertia
            )
        if s < last and not _carry_segment(lanes.works, segment_at(line, (s + 1) * per), lanes.scale, workspace, s):
            return False
    tip = lanes.works.shape[1] - 1
    for p in range(lanes.works.shape[0]):
        end_wrench(lanes.works[p, tip], rod.walls, UNUSED_HISTORY, True, lanes.inertia[tip])
    if not _solve_tip(lanes.works, workspace):
        return False
    _fill_shares(workspace, last)
    return True
