"""Newton's method on the rod's boundary value problem: simple or multiple shooting from the base.

The rod is cut into segments, each with a guessed state at its start. One pass integrates every segment in eight lanes:
the guess, six perturbed along directions that span what the clamped base leaves free, and one along the particular
solution that closes the gaps between segments. The directions are made orthonormal again at every cut (Godunov, Conte),
so growing modes, which overflow simple shooting at small time steps, cannot swamp the others. One segment is simple
shooting.
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from model.kernels.jit import kernel
from model.kernels.law import Walls, branched
from model.kernels.layout import END, HANGS, LANES, LOAD, NODE, PULL, STATE, STRIDE, WRENCH, aligned
from model.kernels.linear_algebra import orthonormalise, solve_six
from model.kernels.rod import Past, integrate, own_past, past_of, wrench
from model.kernels.simd import broadcast, horizontal_sum, horizontal_sum_slopes
from model.kernels.vec3 import Triple, cross, dot, inlined, leaf, plus, put, rotation, triple

Array = Any

# Last Newton update, in units of `scale`, as `newton` measures it; what is left is its square.
TOLERANCE_AT_REST = 1e-5
TOLERANCE_IN_MOTION = 2.5e-3  # the next time step corrects
STEP = 1e-6  # of the one-sided differences, in scaled states
LONGEST = 1.5  # of a Newton update, in scaled strains and orientations


class Workspace(NamedTuple):
    """The arrays that the solver works in, made once so that no step waits for memory."""

    history: Array  # of the next time step, 4 x (N + 1) x 16, flat: as of `time_stepping.advance`
    walls_past: Array  # the walls' past strains in the same places; the history itself where they are only damped
    states: Array  # (N + 1, 128), all lanes
    derivatives: Array  # the same of the slopes of strains and velocities
    x: Array  # (2 N + 2, 16), states at the nodes, a guess that is improved, and then their slopes
    directions: Array  # (N, 7, 16), per segment
    triangle: Array  # (N, 6, 6)
    along: Array  # (N, 6)
    weights: Array  # (N, 8), of the lanes in the solution
    reach: Array  # (N,)
    moved: Array  # (2, 16), by how much at most, and in total, an update moves each quantity
    matrix: Array  # (6, 6)
    right: Array  # (6,)

    @classmethod
    def of(cls, n: int) -> Workspace:
        """Room for n steps along the arm, in up to n segments."""
        return workspace_in(aligned(workspace_size(n)), n)


def workspace_size(n: int, branches: int = 0) -> int:
    """Numbers in a workspace for n steps along an arm whose walls have so many Maxwell branches."""
    own_past = 4 * STATE * (n + 1) if branches else 0
    return (6 * STATE + 2 * STATE * LANES) * (n + 1) + 22 * LANES * n + 10 * LANES + own_past


def workspace_in(pool: Array, n: int, branches: int = 0) -> Workspace:
    """A workspace in one array that holds it all; each of its own begins on a line of the cache."""
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


# Python hands over one array faster than a dozen.
workspace_within = kernel(workspace_in, inlined=True, called=False)


@inlined
def _cap(w: Array, i: int, f: Triple, couple: Triple, place: Triple, c0: float, q_h: Triple, o_h: Triple) -> Any:
    """The tip's force f and couple less what the cap's inertia takes, in the section's frame."""
    mass, inertia = w[(END + 6) * LANES + i], triple(w, END + 7, i)
    q, o = triple(w, NODE + 6, i), triple(w, NODE + 9, i)
    q_t, o_t = plus(q_h, c0, q), plus(o_h, c0, o)
    speed = plus(q, 1.0, cross(o, place))
    f = plus(f, -mass, plus(plus(q_t, 1.0, cross(o_t, place)), 1.0, cross(o, speed)))
    j1, j2, j3 = inertia
    turned = (
        j1 * o_t[0] + (j3 - j2) * o[1] * o[2],
        j2 * o_t[1] + (j1 - j3) * o[2] * o[0],
        j3 * o_t[2] + (j2 - j1) * o[0] * o[1],
    )
    return f, plus(couple, -1.0, turned)


@leaf
def tip_residual(w: Array, walls: Walls, past: Past, own: bool, c0: float, heavy: bool) -> None:
    """Residual of the tip's boundary condition (eqs 23-25, 28) [N, N m], written in place of the wrench.

    After the tip's stage, which leaves the tubes' sums; past and own as there. What hangs on the tip stands at END;
    heavy: it resists acceleration.
    """
    for i in range(LANES):
        _, _, q_h, o_h, v_p, u_p, _, _ = own_past(w, walls, i) if own else past
        n, m = wrench(w, walls, i, NODE, v_p, u_p)
        h = (NODE + 12) * LANES + i
        d1, d2, d3 = rotation((w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]))
        force, moment, place = triple(w, END, i), triple(w, END + 3, i), triple(w, END + 10, i)
        pull, lever = triple(w, PULL, i), triple(w, PULL + 3, i)
        f = (dot(d1, force), dot(d2, force), dot(d3, force))
        couple = (dot(d1, moment), dot(d2, moment), dot(d3, moment))
        couple = plus(couple, 1.0, cross(lever, (dot(d1, pull), dot(d2, pull), dot(d3, pull))))
        if heavy:
            f, couple = _cap(w, i, f, couple, place, c0, q_h, o_h)
        couple = plus(couple, 1.0, cross(place, f))
        put(w, WRENCH, i, plus(n, -1.0, f))
        put(w, WRENCH + 3, i, plus(m, -1.0, couple))


@inlined
def _start_segment(w: Array, workspace: Workspace, scale: Array, s: int, start: int) -> None:
    """Set the lanes at the start of segment s, node `start`: the guess and the runs that are moved along directions."""
    x, directions, reach = workspace.x, workspace.directions, workspace.reach
    for c in range(STATE):
        broadcast(w, NODE + c, x[start, c])
    if s == 0:
        for k in range(6):
            w[(NODE + k) * LANES + 1 + k] += STEP * scale[k]
    else:
        particular = 0.0
        for c in range(STATE):
            particular += directions[s, 6, c] ** 2
        reach[s] = STEP / particular**0.5 if particular > 0.0 else 0.0
        for c in range(STATE):
            at, unit = (NODE + c) * LANES, scale[c]
            for k in range(6):
                w[at + 1 + k] += STEP * unit * directions[s, k, c]
            w[at + 7] += reach[s] * unit * directions[s, 6, c]


@inlined
def _carry_directions(w: Array, workspace: Workspace, scale: Array, s: int, end: int) -> bool:
    """Directions of segment s + 1 from where segment s ends, at node `end`, made orthonormal; False where they are not.

    The seventh one closes the gap between the segments; its parts along the others stand in `along`.
    """
    x, directions, along, reach = workspace.x, workspace.directions, workspace.along, workspace.reach
    for c in range(STATE):
        at = (NODE + c) * LANES
        for k in range(6):
            directions[s + 1, k, c] = (w[at + 1 + k] - w[at]) * (scale[STATE + c] / STEP)
        carried = (w[at + 7] - w[at]) / (reach[s] * scale[c]) if reach[s] > 0.0 else 0.0
        directions[s + 1, 6, c] = carried + (w[at] - x[end, c]) / scale[c]
    if not orthonormalise(directions[s + 1, :6], workspace.triangle[s + 1]):
        return False
    for k in range(6):
        share = 0.0
        for c in range(STATE):
            share += directions[s + 1, k, c] * directions[s + 1, 6, c]
        along[s + 1, k] = share
    for k in range(6):
        for c in range(STATE):
            directions[s + 1, 6, c] -= along[s + 1, k] * directions[s + 1, k, c]
    return True


@inlined
def _solve_tip(w: Array, workspace: Workspace, last: int) -> bool:
    """Shares of the last segment's directions that meet the tip's condition, in workspace.right; False for none."""
    reach, matrix, right = workspace.reach, workspace.matrix, workspace.right
    for i in range(6):
        at = (WRENCH + i) * LANES
        lacking = w[at]
        carried = (w[at + 7] - lacking) / reach[last] if reach[last] > 0.0 else 0.0
        right[i] = -lacking - carried
        for k in range(6):
            matrix[i, k] = (w[at + 1 + k] - lacking) * (1.0 / STEP)
    return solve_six(matrix, right)  # type: ignore[no-any-return]


@inlined
def _fill_weights(workspace: Workspace, last: int) -> None:
    """Weights of the lanes in the update, of every segment, from the last to the first."""
    weights, reach, right, along, triangle = (
        workspace.weights,
        workspace.reach,
        workspace.right,
        workspace.along,
        workspace.triangle,
    )
    for s in range(last, -1, -1):
        for k in range(6):
            weights[s, k + 1] = right[k] * (1.0 / STEP)
        weights[s, 7] = 1.0 / reach[s] if reach[s] > 0.0 else 0.0
        # Against lane 0.
        weights[s, 0] = 0.0
        for i in range(1, LANES):
            weights[s, 0] -= weights[s, i]
        if s > 0:
            for k in range(5, -1, -1):
                total = right[k] - along[s, k]
                for c in range(k + 1, 6):
                    total -= triangle[s, k, c] * right[c]
                right[k] = total / triangle[s, k, k]


@inlined
def _measure_update(moved: Array, scale: Array) -> tuple[float, float, float]:
    """Of an update, in units of `scale`: the largest part in velocities, in strains and orientations; their total."""
    swift, bent, total = 0.0, 0.0, 0.0
    for c in range(6):
        swift = max(swift, moved[0, 6 + c] * scale[STATE + 6 + c])
        bent = max(bent, moved[0, c] * scale[STATE + c])
    for c in range(12, STATE):
        bent = max(bent, moved[0, c] * scale[STATE + c])
    for c in range(STATE):
        total += moved[1, c]
    return swift, bent, total


@leaf
def newton(
    w: Array,
    walls: Walls,
    load: Array,
    loaded: bool,
    tip: Array,
    c0: float,
    length: float,
    segments: int,
    scale: Array,
    workspace: Workspace,
    tolerance: float,
    most: float,
    longest: float,
) -> int:
    """Solve for the states at the nodes, and their slopes, from a guess in workspace.x; N divides by `segments`.

    The history stands in `workspace`. tip (19,): what hangs there, as it stands at END. All nodes are moved along the
    computed directions. The error after an update is of the order of its size, in units of `scale`, times the size of
    its part in strains and orientations: the iteration stops when this product is below the square of `tolerance`. An
    update of strains and orientations longer than LONGEST is shortened to that; one longer than `longest` is refused.
    Returns the number of passes, or -1 when `most` were not enough (no int: numba would compile
    this anew for every constant) or an update was refused.
    """
    history, walls_past = workspace.history, workspace.walls_past
    states, derivatives, x = workspace.states, workspace.derivatives, workspace.x
    heavy = tip[6] > 0.0 or tip[7] > 0.0 or tip[8] > 0.0 or tip[9] > 0.0
    weights, moved = workspace.weights, workspace.moved
    n = states.shape[0] - 1
    per, last = n // segments, segments - 1
    broadcast(w, STRIDE, length / n)
    for c in range(HANGS):
        broadcast(w, END + c, tip[c])
    if not loaded:
        for c in range(6):
            broadcast(w, LOAD + c, 0.0)
    workspace.reach[0] = 0.0
    previous = np.inf
    for passes in range(1, int(most) + 1):
        for s in range(segments):
            _start_segment(w, workspace, scale, s, s * per)
            integrate(w, walls, history, walls_past, load, loaded, s * per, (s + 1) * per, states, derivatives)
            if s < last and not _carry_directions(w, workspace, scale, s, (s + 1) * per):
                return -1
        past = past_of(history, walls_past if branched(walls.law) else history, STATE * (n + 1), STATE * n)
        tip_residual(w, walls, past, False, c0, heavy)
        if not _solve_tip(w, workspace, last):
            return -1
        _fill_weights(workspace, last)
        for c in range(STATE):
            moved[0, c], moved[1, c] = 0.0, 0.0
        for s in range(segments):
            for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                horizontal_sum(weights, s, states, j, x, moved)
        swift, bent, total = _measure_update(moved, scale)
        largest = max(swift, bent)
        # A maximum swallows a NaN and would call the step solved; a sum does not.
        if not total < np.inf:
            return -1
        if (largest > 4.0 * previous and largest > 1.0) or bent > longest:
            return -1
        previous = largest
        # Strain and orientation make the equations nonlinear; velocities may move as far as they like.
        if bent > LONGEST:
            damping = LONGEST / bent
            for j in range(n + 1):
                for c in range(STATE):
                    x[j, c] = states[j, c * LANES] + damping * (x[j, c] - states[j, c * LANES])
        if bent * largest < tolerance * tolerance:
            for s in range(segments):
                for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                    horizontal_sum_slopes(weights, s, derivatives, j, x, n + 1 + j, moved)
            for c in range(12):
                total += abs(moved[1, c])
            return passes if total < np.inf else -1
    return -1


class _WorkspaceCache(threading.local):
    workspace: Workspace | None = None


_kept = _WorkspaceCache()


def workspace_for(n: int) -> Workspace:
    """Room for n steps, the same one at every call from one thread: what it holds must be copied out at once."""
    if _kept.workspace is None or len(_kept.workspace.states) != n + 1:
        _kept.workspace = Workspace.of(n)
    return _kept.workspace
