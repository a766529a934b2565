"""Newton's method on the rod's boundary value problem: simple or multiple shooting from the base.

The rod is divided into shooting segments, whatever the segments of the arm, each with a guessed state at its start. One
iteration integrates every segment in eight lanes: the guess, six states perturbed along directions that span the free
base strains, and one perturbed along the particular solution that closes the gaps between segments. The directions are
made orthonormal again at the start of each segment (Godunov, Conte), so that modes that grow along the rod, which
overflow simple shooting at small time steps, do not hide the others. One segment is simple shooting.
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from model.kernels.arguments import Rod, segment_at
from model.kernels.integration import integrate
from model.kernels.jit import kernel
from model.kernels.joints import end_wrench, has_inertia
from model.kernels.lane_sums import broadcast, horizontal_sum, horizontal_sum_slopes
from model.kernels.law import branched
from model.kernels.layout import (
    LANES,
    LOAD,
    NODE,
    STATE,
    STEP_LENGTH,
    TIP_LOAD,
    TIP_LOAD_SIZE,
    WRENCH,
    aligned,
)
from model.kernels.linear_algebra import orthonormalise, solve_six
from model.kernels.rod import past_of
from model.kernels.vec3 import inlined, leaf

Array = Any

# Of the last Newton update, in units of `scale`, as `newton` measures it; the remaining error is about its square.
TOLERANCE_AT_REST = 1e-5
TOLERANCE_IN_MOTION = 2.5e-3  # the next time step corrects the rest
STEP = 1e-6  # of the one-sided differences, in scaled states
LONGEST_UPDATE = 1.5  # of a Newton update, in scaled strains and orientations


class Workspace(NamedTuple):
    """Arrays of the solver, allocated once for many solutions, for N steps along the arm."""

    history: Array  # of the next time step, 4 x (N + 1) x 16, flat: as of `time_stepping.advance`
    walls_past: Array  # past strains of the walls, in the same layout; the history itself without Maxwell branches
    states: Array  # (N + 1, 128), of all lanes
    derivatives: Array  # (N + 1, 128), derivatives of strains and velocities along the arm
    x: Array  # (2 N + 2, 16), states at the nodes, from guess to solution, then their derivatives
    directions: Array  # (N, 7, 16), per segment
    triangle: Array  # (N, 6, 6), of the orthonormalisation
    projections: Array  # (N, 6), of the particular solution on the directions
    weights: Array  # (N, 8), of the lanes in the Newton update
    particular_step: Array  # (N,), size of the perturbation along the particular solution
    update: Array  # (2, 16), largest absolute Newton update of each quantity over all nodes, and their sum
    matrix: Array  # (6, 6), Jacobian of the residual at the tip
    right: Array  # (6,)


def workspace_size(n: int, branches: int = 0) -> int:
    """Number of doubles in a workspace for N steps along an arm whose walls have B Maxwell branches."""
    own_past = 4 * STATE * (n + 1) if branches else 0
    return (6 * STATE + 2 * STATE * LANES) * (n + 1) + 22 * LANES * n + 10 * LANES + own_past


def workspace_in(pool: Array, n: int, branches: int = 0) -> Workspace:
    """Divide one array into the arrays of a workspace, each of which begins on a line of the cache."""
    a = 4 * STATE * (n + 1)
    past = len(pool) - a if branches > 0 else 0
    b = a + STATE * LANES * (n + 1)
    c = b + STATE * LANES * (n + 1)
    d = c + 2 * STATE * (n + 1)
    e = d + 14 * LANES * n
    f = e + 5 * LANES * n
    g = f + LANES * n
    h = g + LANES * n
    i = h + LANES * n
    j = i + 4 * LANES
    k = j + 5 * LANES
    return Workspace(
        pool[:a], pool[past : past + a],
        pool[a:b].reshape(n + 1, STATE * LANES), pool[b:c].reshape(n + 1, STATE * LANES),
        pool[c:d].reshape(2 * n + 2, STATE), pool[d:e].reshape(n, 7, STATE),
        pool[e : e + 36 * n].reshape(n, 6, 6), pool[f : f + 6 * n].reshape(n, 6), pool[g:h].reshape(n, LANES),
        pool[h : h + n], pool[i:j].reshape(2, STATE), pool[j : j + 36].reshape(6, 6), pool[k : k + 6],
    )  # fmt: skip


# One array takes numba less time to unpack than thirteen.
workspace_within = kernel(workspace_in, inlined=True, called=False)


@inlined
def _start_segment(w: Array, workspace: Workspace, scale: Array, s: int, start: int) -> None:
    """Set the lanes at the start of segment s, node `start`: the guess, and states perturbed along the directions."""
    x, directions, particular_step = workspace.x, workspace.directions, workspace.particular_step
    for c in range(STATE):
        broadcast(w, NODE + c, x[start, c])
    if s == 0:
        for k in range(6):
            w[(NODE + k) * LANES + 1 + k] += STEP * scale[k]
    else:
        particular = 0.0
        for c in range(STATE):
            particular += directions[s, 6, c] ** 2
        particular_step[s] = STEP / particular**0.5 if particular > 0.0 else 0.0
        for c in range(STATE):
            at, unit = (NODE + c) * LANES, scale[c]
            for k in range(6):
                w[at + 1 + k] += STEP * unit * directions[s, k, c]
            w[at + 7] += particular_step[s] * unit * directions[s, 6, c]


@inlined
def _carry_directions(w: Array, workspace: Workspace, scale: Array, s: int, end: int) -> bool:
    """Orthonormal directions of segment s + 1 from the end of segment s, at node `end`; False if they are dependent.

    The seventh is the particular solution, which closes the gap between the segments; its projections on the others
    are removed and kept.
    """
    x, directions, projections, particular_step = (
        workspace.x,
        workspace.directions,
        workspace.projections,
        workspace.particular_step,
    )
    for c in range(STATE):
        at = (NODE + c) * LANES
        for k in range(6):
            directions[s + 1, k, c] = (w[at + 1 + k] - w[at]) * (scale[STATE + c] / STEP)
        carried = (w[at + 7] - w[at]) / (particular_step[s] * scale[c]) if particular_step[s] > 0.0 else 0.0
        directions[s + 1, 6, c] = carried + (w[at] - x[end, c]) / scale[c]
    if not orthonormalise(directions[s + 1, :6], workspace.triangle[s + 1]):
        return False
    for k in range(6):
        share = 0.0
        for c in range(STATE):
            share += directions[s + 1, k, c] * directions[s + 1, 6, c]
        projections[s + 1, k] = share
    for k in range(6):
        for c in range(STATE):
            directions[s + 1, 6, c] -= projections[s + 1, k] * directions[s + 1, k, c]
    return True


@inlined
def _solve_tip(w: Array, workspace: Workspace, last: int) -> bool:
    """Solve for the weights of the last segment's directions, in workspace.right; False if the Jacobian is singular."""
    particular_step, matrix, right = workspace.particular_step, workspace.matrix, workspace.right
    for i in range(6):
        at = (WRENCH + i) * LANES
        residual = w[at]
        carried = (w[at + 7] - residual) / particular_step[last] if particular_step[last] > 0.0 else 0.0
        right[i] = -residual - carried
        for k in range(6):
            matrix[i, k] = (w[at + 1 + k] - residual) * (1.0 / STEP)
    return solve_six(matrix, right)  # type: ignore[no-any-return]


@inlined
def _fill_weights(workspace: Workspace, last: int) -> None:
    """Weights of the lanes in the Newton update, of every segment, by back substitution from the last to the first."""
    weights, particular_step, right, projections, triangle = (
        workspace.weights,
        workspace.particular_step,
        workspace.right,
        workspace.projections,
        workspace.triangle,
    )
    for s in range(last, -1, -1):
        for k in range(6):
            weights[s, k + 1] = right[k] * (1.0 / STEP)
        weights[s, 7] = 1.0 / particular_step[s] if particular_step[s] > 0.0 else 0.0
        # All lanes count relative to lane 0.
        weights[s, 0] = 0.0
        for i in range(1, LANES):
            weights[s, 0] -= weights[s, i]
        if s > 0:
            for k in range(5, -1, -1):
                total = right[k] - projections[s, k]
                for c in range(k + 1, 6):
                    total -= triangle[s, k, c] * right[c]
                right[k] = total / triangle[s, k, k]


@inlined
def _measure_update(update: Array, scale: Array) -> tuple[float, float, float]:
    """Largest update of velocities, and of strains and orientations, in units of `scale`; sum of all updates."""
    velocity_update, strain_update, total = 0.0, 0.0, 0.0
    for c in range(6):
        velocity_update = max(velocity_update, update[0, 6 + c] * scale[STATE + 6 + c])
        strain_update = max(strain_update, update[0, c] * scale[STATE + c])
    for c in range(12, STATE):
        strain_update = max(strain_update, update[0, c] * scale[STATE + c])
    for c in range(STATE):
        total += update[1, c]
    return velocity_update, strain_update, total


@leaf
def newton(
    rod: Rod, segments: int, workspace: Workspace, tolerance: float, max_passes: float, max_update: float
) -> int:
    """Solve for the states at the nodes, and their derivatives, from a guess in workspace.x; N divides by `segments`.

    The history stands in `workspace`. The error after an update
    is of the order of its size, in units of `scale`, times the size of its part in strains and orientations: the
    iteration ends when this product is below the square of `tolerance`. An update of strains and orientations longer
    than LONGEST_UPDATE is shortened to it; one longer than `max_update` ends the iteration. Returns the number of
    iterations, or -1 without a solution after `max_passes` (a float: numba would compile the kernel again for each
    constant integer).
    """
    walls, scale, line = rod.walls, rod.scale, rod.line
    history, walls_past = workspace.history, workspace.walls_past
    states, derivatives, x = workspace.states, workspace.derivatives, workspace.x
    weights, update = workspace.weights, workspace.update
    n = states.shape[0] - 1
    per, last = n // segments, segments - 1
    tip = rod.work.shape[0] - 1
    for k in range(tip + 1):
        broadcast(rod.work[k], STEP_LENGTH, line.step[k])
        for c in range(TIP_LOAD_SIZE):
            broadcast(rod.work[k], TIP_LOAD + c, rod.ends[k, c])
        if not rod.loaded:
            for c in range(6):
                broadcast(rod.work[k], LOAD + c, 0.0)
    workspace.particular_step[0] = 0.0
    previous = np.inf
    for passes in range(1, int(max_passes) + 1):
        for s in range(segments):
            start, end = s * per, (s + 1) * per
            _start_segment(rod.work[segment_at(line, start)], workspace, scale, s, start)
            integrate(rod, history, walls_past, start, end, states, derivatives, x)
            if s < last and not _carry_directions(rod.work[segment_at(line, end)], workspace, scale, s, end):
                return -1
        past = past_of(history, walls_past if branched(walls.law) else history, STATE * (n + 1), STATE * n)
        end_wrench(rod.work[tip], walls, past, False, has_inertia(rod.ends[tip]))
        if not _solve_tip(rod.work[tip], workspace, last):
            return -1
        _fill_weights(workspace, last)
        for c in range(STATE):
            update[0, c], update[1, c] = 0.0, 0.0
        for s in range(segments):
            for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                horizontal_sum(weights, s, states, j, x, update)
        velocity_update, strain_update, total = _measure_update(update, scale)
        largest = max(velocity_update, strain_update)
        # A maximum ignores a NaN and would accept the update; a sum does not.
        if not total < np.inf:
            return -1
        if (largest > 4.0 * previous and largest > 1.0) or strain_update > max_update:
            return -1
        previous = largest
        # Strains and orientations make the equations nonlinear; the velocities need no limit.
        if strain_update > LONGEST_UPDATE:
            damping = LONGEST_UPDATE / strain_update
            for j in range(n + 1):
                for c in range(STATE):
                    x[j, c] = states[j, c * LANES] + damping * (x[j, c] - states[j, c * LANES])
        if strain_update * largest < tolerance * tolerance:
            for s in range(segments):
                for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                    horizontal_sum_slopes(weights, s, derivatives, j, x, n + 1 + j, update)
            for c in range(12):
                total += abs(update[1, c])
            return passes if total < np.inf else -1
    return -1


class _WorkspaceCache(threading.local):
    pool: Array = None
    workspace: Workspace | None = None


_kept = _WorkspaceCache()


def workspace_for(n: int) -> tuple[Array, Workspace]:
    """The workspace of this thread for N steps along the arm, after its pool; valid until the next solution."""
    if _kept.workspace is None or len(_kept.workspace.states) != n + 1:
        _kept.pool = aligned(workspace_size(n))
        _kept.workspace = workspace_in(_kept.pool, n)
    return _kept.pool, _kept.workspace
