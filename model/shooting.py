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

from model.layout import END, HANGS, LANES, LINEAR, LOAD, NODE, POINTWISE, PULL, STATE, STRIDE, WRENCH, aligned
from model.linear import orthonormalise, solve_six
from model.rod import Past, integrate, own_past, past_of, wrench
from model.triples import (
    Triple,
    cross,
    dot,
    inlined,
    lane_sums,
    leaf,
    plus,
    put,
    rotation,
    size,
    sum_of,
    three,
    triple,
    write,
)

Array = Any

STEP = 1e-6  # of the one-sided differences, in scaled states
LONGEST = 1.5  # of a Newton update, in scaled strains and orientations


class Room(NamedTuple):
    """The arrays that the solver works in, made once so that no step waits for memory."""

    history: Array  # of the next time step, 4 x (N + 1) x 16, flat: as of `march.advance`
    states: Array  # (N + 1, 128), all lanes
    derivatives: Array  # the same of their slopes
    x: Array  # (2 N + 2, 16), states at the nodes, a guess that is improved, and then their slopes
    directions: Array  # (N, 7, 16), per segment
    triangle: Array  # (N, 6, 6)
    along: Array  # (N, 6)
    weights: Array  # (N, 8), of the lanes in the solution
    reach: Array  # (N,)
    matrix: Array  # (6, 6)
    right: Array  # (6,)

    @classmethod
    def of(cls, n: int) -> Room:
        """Room for n steps along the arm, in up to n segments."""
        return cls(
            aligned(4 * (n + 1) * STATE), aligned(n + 1, STATE * LANES), aligned(n + 1, STATE * LANES),
            aligned(2 * n + 2, STATE), aligned(n, 7, STATE), aligned(n, 6, 6), aligned(n, 6),
            aligned(n, LANES), aligned(n), aligned(6, 6), aligned(6),
        )  # fmt: skip


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
def tip_residual(w: Array, law: int, past: Past, own: bool, c0: float, heavy: bool) -> None:
    """What the wrench at the tip, the node, lacks of what hangs on it (eqs 23-25, 28) [N, N m], in the wrench's place.

    After the tip's stage, which leaves the tubes' sums; past and own as there. What hangs on the tip stands at END;
    heavy: it resists acceleration.
    """
    for i in range(LANES):
        v_h, u_h, q_h, o_h, _, _ = own_past(w, i) if own else past
        n, m = wrench(w, LINEAR, i, NODE, v_h, u_h) if law == LINEAR else wrench(w, POINTWISE, i, NODE, v_h, u_h)
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
def _everywhere(w: Array, x: Array, j: int, lanes: int) -> None:
    """The state in row j of x to the node, all lanes: a loop only while the compiler does not know their number."""
    v, u, q, o, h = three(x[j], 0), three(x[j], 3), three(x[j], 6), three(x[j], 9), three(x[j], 13)
    h0 = x[j, 12]
    for i in range(lanes):
        put(w, NODE, i, v)
        put(w, NODE + 3, i, u)
        put(w, NODE + 6, i, q)
        put(w, NODE + 9, i, o)
        w[(NODE + 12) * LANES + i] = h0
        put(w, NODE + 13, i, h)


@leaf
def newton(
    w: Array,
    law: int,
    actuators: int,
    load: Array,
    loaded: bool,
    tip: Array,
    c0: float,
    length: float,
    segments: int,
    scale: Array,
    room: Room,
    tolerance: float,
    most: float,
) -> int:
    """Solve for the states at the nodes, and their slopes, from a guess in room.x; N divides by `segments`.

    The history stands in `room` too. tip (19,): what hangs there, as it stands at END. All nodes are moved along the
    computed directions. What is left after an update is of the order of its size, in units of `scale`, times that of
    its strains and orientations, which make the equations nonlinear: it stops when this product is below the square of
    `tolerance`. Returns the number of passes, or -1 when `most` were not enough (no int: numba would compile this anew
    for every constant).
    """
    history, states, derivatives, x = room.history, room.states, room.derivatives, room.x
    heavy = tip[6] > 0.0 or tip[7] > 0.0 or tip[8] > 0.0 or tip[9] > 0.0
    directions, triangle, along, weights = room.directions, room.triangle, room.along, room.weights
    reach, matrix, right = room.reach, room.matrix, room.right
    n = states.shape[0] - 1
    per = n // segments
    last = segments - 1
    for i in range(LANES):
        w[STRIDE * LANES + i] = length / n
        for c in range(HANGS):
            w[(END + c) * LANES + i] = tip[c]
        if not loaded:
            put(w, LOAD, i, (0.0, 0.0, 0.0))
            put(w, LOAD + 3, i, (0.0, 0.0, 0.0))
    reach[0] = 0.0
    previous = np.inf
    for passes in range(1, int(most) + 1):
        for s in range(segments):
            _everywhere(w, x, s * per, room.weights.shape[1])
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
            integrate(w, law, actuators, history, load, loaded, s * per, (s + 1) * per, states, derivatives)
            if s == segments - 1:
                break
            for c in range(STATE):
                at = (NODE + c) * LANES
                for k in range(6):
                    directions[s + 1, k, c] = (w[at + 1 + k] - w[at]) * (scale[STATE + c] / STEP)
                carried = (w[at + 7] - w[at]) / (reach[s] * scale[c]) if reach[s] > 0.0 else 0.0
                directions[s + 1, 6, c] = carried + (w[at] - x[(s + 1) * per, c]) / scale[c]
            if not orthonormalise(directions[s + 1, :6], triangle[s + 1]):
                return -1
            for k in range(6):
                dot = 0.0
                for c in range(STATE):
                    dot += directions[s + 1, k, c] * directions[s + 1, 6, c]
                along[s + 1, k] = dot
            for k in range(6):
                for c in range(STATE):
                    directions[s + 1, 6, c] -= along[s + 1, k] * directions[s + 1, k, c]
        past = past_of(history, STATE * (n + 1), STATE * n)
        tip_residual(w, law, past, False, c0, heavy)
        for i in range(6):
            at = (WRENCH + i) * LANES
            lacking = w[at]
            carried = (w[at + 7] - lacking) / reach[last] if reach[last] > 0.0 else 0.0
            right[i] = -lacking - carried
            for k in range(6):
                matrix[i, k] = (w[at + 1 + k] - lacking) * (1.0 / STEP)
        if not solve_six(matrix, right):
            return -1
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
        swift, bent, total = 0.0, 0.0, 0.0
        for s in range(segments):
            for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                v, u, q, o, h0, h = lane_sums(weights, s, states, j)
                write(x, j, 0, v)
                write(x, j, 3, u)
                write(x, j, 6, q)
                write(x, j, 9, o)
                x[j, 12] = h0
                write(x, j, 13, h)
                swift = max(swift, max(size(q) * scale[STATE + 6], size(o) * scale[STATE + 9]))
                turned = max(abs(h0), size(h)) * scale[STATE + 12]
                bent = max(bent, max(max(size(v) * scale[STATE], size(u) * scale[STATE + 3]), turned))
                total += ((sum_of(v) + sum_of(u)) + (sum_of(q) + sum_of(o))) + (sum_of(h) + abs(h0))
        largest = max(swift, bent)
        # A maximum swallows a NaN and would call the step solved; a sum does not.
        if not total < np.inf:
            return -1
        if largest > 4.0 * previous and largest > 1.0:
            return -1
        previous = largest
        # Strain and orientation make the equations nonlinear; velocities may move as far as they like.
        damping = 1.0 if bent <= LONGEST else LONGEST / bent
        for j in range(n + 1):
            for c in range(STATE):
                x[j, c] = states[j, c * LANES] + damping * x[j, c]
        if bent * largest < tolerance * tolerance:
            for s in range(segments):
                weights[s, 0] += 1.0
                for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                    v, u, q, o, _, _ = lane_sums(weights, s, derivatives, j)
                    write(x, n + 1 + j, 0, v)
                    write(x, n + 1 + j, 3, u)
                    write(x, n + 1 + j, 6, q)
                    write(x, n + 1 + j, 9, o)
                    total += (sum_of(v) + sum_of(u)) + (sum_of(q) + sum_of(o))
            return passes if total < np.inf else -1
    return -1


class _Kept(threading.local):
    room: Room | None = None


_kept = _Kept()


def room_for(n: int) -> Room:
    """Room for n steps, the same one at every call from one thread: what it holds must be copied out at once."""
    if _kept.room is None or len(_kept.room.states) != n + 1:
        _kept.room = Room.of(n)
    return _kept.room
