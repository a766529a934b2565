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

from model.layout import HISTORY, LANES, NODE, SLOPE, STAGE, STATE, STRIDE, WRENCH, aligned
from model.linear import orthonormalise, solve_six
from model.rod import integrate, slopes, stage_wrench
from model.triples import cross, dot, inlined, lane_sum, leaf, plus, put, rotation, three, triple

Array = Any

STEP = 1e-6  # of the one-sided differences, in scaled states
LONGEST = 1.5  # of a Newton update, in scaled strains and orientations


class Room(NamedTuple):
    """The arrays that the solver works in, made once so that no step waits for memory."""

    history: Array  # 2 N + 1 rows of 18, flat
    states: Array  # (N + 1, 128), all lanes
    derivatives: Array  # the same of their slopes
    x: Array  # (N + 1, 16), the guess that is improved
    slope: Array
    directions: Array  # (N, 7, 16), per segment
    triangle: Array  # (N, 6, 6)
    along: Array  # (N, 6)
    weights: Array  # (N, 8), of the lanes in the solution
    reach: Array  # (N,)
    matrix: Array  # (6, 6)
    right: Array  # (6,)
    over: Array  # (16,), 1 / scale

    @classmethod
    def of(cls, n: int) -> Room:
        """Room for n steps along the arm, in up to n segments."""
        return cls(
            aligned((2 * n + 1) * HISTORY), aligned(n + 1, STATE * LANES), aligned(n + 1, STATE * LANES),
            aligned(n + 1, STATE), aligned(n + 1, STATE), aligned(n, 7, STATE), aligned(n, 6, 6), aligned(n, 6),
            aligned(n, LANES), aligned(n), aligned(6, 6), aligned(6), aligned(STATE),
        )  # fmt: skip


@inlined
def cap(
    w: Array, i: int, f: Any, couple: Any, mass: float, inertia: Any, place: Any, c0: float, q_h: Any, o_h: Any
) -> Any:
    """The tip's force f and couple less what the cap's inertia takes, in the section's frame."""
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
def tip_residual(w: Array, law: int, actuators: int, history: Array, row: int, tip: Array, c0: float) -> None:
    """What the tip's total wrench lacks of what hangs on it (eqs 23-25, 28) [N, N m], in the wrench's place.

    tip: dead force (3) and moment (3) in the base frame, cap mass that resists acceleration, cap inertia (3), place of
    the load in the section (3).
    """
    for i in range(STATE * LANES):
        w[STAGE * LANES + i] = w[NODE * LANES + i]
    stage_wrench(w, law, actuators, history, row)
    force, moment, place = three(tip, 0), three(tip, 3), three(tip, 10)
    mass, inertia = tip[6], three(tip, 7)
    heavy = mass > 0.0 or inertia[0] > 0.0 or inertia[1] > 0.0 or inertia[2] > 0.0
    q_h, o_h = three(history, HISTORY * row + 6), three(history, HISTORY * row + 9)
    for i in range(LANES):
        h = (NODE + 12) * LANES + i
        d1, d2, d3 = rotation((w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]))
        f = (dot(d1, force), dot(d2, force), dot(d3, force))
        couple = (dot(d1, moment), dot(d2, moment), dot(d3, moment))
        if heavy:
            f, couple = cap(w, i, f, couple, mass, inertia, place, c0, q_h, o_h)
        couple = plus(couple, 1.0, cross(place, f))
        put(w, WRENCH, i, plus(triple(w, WRENCH, i), -1.0, f))
        put(w, WRENCH + 3, i, plus(triple(w, WRENCH + 3, i), -1.0, couple))


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
    """Solve for the states x (N + 1, 16) at the nodes, and their slopes, from a guess in x; N divides by `segments`.

    x, slope and the history stand in `room`. All nodes are moved along the computed directions. What is left after an
    update is of the order of its size, in units of `scale`, times that of its strains and orientations, which make the
    equations nonlinear: it stops when this product is below the square of `tolerance`. Returns the number of passes, or
    -1 when `most` were not enough (no int: numba would compile this anew for every constant).
    """
    history, states, derivatives, x, slope = room.history, room.states, room.derivatives, room.x, room.slope
    directions, triangle, along, weights = room.directions, room.triangle, room.along, room.weights
    reach, matrix, right, over = room.reach, room.matrix, room.right, room.over
    n = x.shape[0] - 1
    per = n // segments
    last = segments - 1
    for i in range(LANES):
        w[STRIDE * LANES + i] = length / n
    for c in range(STATE):
        over[c] = 1.0 / scale[c]
    reach[0] = 0.0
    previous = np.inf
    for passes in range(1, int(most) + 1):
        for s in range(segments):
            for c in range(STATE):
                for i in range(LANES):
                    w[(NODE + c) * LANES + i] = x[s * per, c]
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
                    directions[s + 1, k, c] = (w[at + 1 + k] - w[at]) * (over[c] / STEP)
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
        for i in range(STATE * LANES):
            states[n, i] = w[NODE * LANES + i]
        tip_residual(w, law, actuators, history, 2 * n, tip, c0)
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
        # One number after the other: as vectors over c, the lanes would be gathered, which takes five times as long.
        swift, bent, total = 0.0, 0.0, 0.0
        for s in range(segments):
            for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                for c in range(STATE):
                    update = lane_sum(weights, s, states, j, c)
                    x[j, c] = update
                    size = abs(update) * over[c]
                    total += size
                    if 6 <= c < 12:
                        swift = max(swift, size)
                    else:
                        bent = max(bent, size)
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
                for j in range(s * per, (s + 1) * per):
                    for c in range(STATE):
                        slope[j, c] = derivatives[j, c * LANES] + lane_sum(weights, s, derivatives, j, c)
                        total += slope[j, c]
            if not abs(total) < np.inf:
                return -1
            for c in range(STATE):
                for i in range(LANES):
                    w[(STAGE + c) * LANES + i] = x[n, c]
            slopes(w, law, actuators, history, load, loaded, 2 * n)
            for c in range(STATE):
                slope[n, c] = w[(SLOPE + c) * LANES]
            return passes
    return -1


class _Kept(threading.local):
    room: Room | None = None


_kept = _Kept()


def room_for(n: int) -> Room:
    """Room for n steps, the same one at every call from one thread: what it holds must be copied out at once."""
    if _kept.room is None or len(_kept.room.x) != n + 1:
        _kept.room = Room.of(n)
    return _kept.room
