"""Kernels for arms that differ a little: each lane carries one, and all are solved from one solution in one pass.

By the implicit function theorem. At a solved arm, one pass moves its base strains, lane by lane, and integrates its
neighbours: the same arm but for a parameter, a pressure, a load or a past. What a neighbour's tip then lacks is made
good along the moved base strains, so no further Newton iterations are needed. Lanes are counted through all work
arrays: 0 is the arm, 1 to 6 move a base strain each, the neighbours follow.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from model.axis import axis
from model.compiled import kernel
from model.layout import (
    AXIAL,
    AXIAL_INVERSE,
    C0,
    CENTRE,
    END,
    GATHER,
    HISTORY,
    INERTIA,
    LAG,
    LANES,
    LINE_DENSITY,
    LINEAR,
    LOAD,
    MORE,
    NODE,
    OFFSET,
    PAST,
    PER_TUBE,
    POINTWISE,
    PULL,
    SHEAR,
    SHEAR_INVERSE,
    SLOPE,
    STAGE,
    STATE,
    STRAINS,
    STRIDE,
    TRIO,
    WEIGHT,
    WRENCH,
    aligned,
)
from model.linear import orthonormalise
from model.march import advance, equilibrium
from model.pointwise import pointwise_slopes, pointwise_wrench, sum_tubes
from model.rod import balance, linear_slopes, linear_wrench
from model.shooting import Room, cap, newton
from model.triples import Triple, cross, dot, inlined, leaf, plus, put, rotation, six, three, triple

Array = Any

FIRST = 7  # lane of the first neighbour
STEP = 1e-7  # of the moved base strains, in scaled states
# The lever of a pull turns with the tip: it is found anew until it stands still, or the pull is not met.
LEVER_PASSES, LEVER_STILL = 80, 1e-8
NO_MOMENT = 1e-15  # [N m]: a pull so small that its moments have no digits


class Lanes(NamedTuple):
    """The arrays that the lanes work in."""

    states: Array  # (2, W, N + 1, 128) of every work array, now and a time step before
    derivatives: Array  # the same of their slopes
    directions: Array  # (S, 6, 16), per segment
    triangle: Array  # (S, 6, 6)
    along: Array  # (S, P, 6), per segment and neighbour
    parts: Array  # (P, 16), by what each neighbour differs at a segment's start
    shares: Array  # (S, W, 6, 8), of the moved base strains in each lane
    matrix: Array  # (6, 6)
    right: Array  # (P, 6)
    place: Array  # (W, 6, 8), tip and turn of every lane

    @classmethod
    def of(cls, neighbours: int, n: int, segments: int) -> Lanes:
        """Room for so many neighbours on n steps along the arm."""
        works = passes(neighbours)
        size = 2, works, n + 1, STATE * LANES
        return cls(
            aligned(*size), aligned(*size), aligned(segments, 6, STATE), aligned(segments, 6, 6),
            aligned(segments, neighbours, 6), aligned(neighbours, STATE),
            aligned(segments, works, 6, LANES), aligned(6, 6), aligned(neighbours, 6), aligned(works, 6, LANES),
        )  # fmt: skip


def passes(neighbours: int) -> int:
    """Work arrays, and so passes, for so many neighbours."""
    return -(-(FIRST + neighbours) // LANES)


@inlined
def _balanced(w: Array, i: int, n: Triple, m: Triple) -> Any:
    """`rod.balance` of one lane, whose wrench is n, m."""
    j, past = INERTIA * LANES + i, PAST
    return balance(
        w[C0 * LANES + i], w[LINE_DENSITY * LANES + i], (w[j], w[j + LANES], w[j + 2 * LANES], w[j + 3 * LANES]),
        triple(w, STAGE, i), triple(w, STAGE + 3, i), triple(w, STAGE + 6, i), triple(w, STAGE + 9, i), n, m,
        (triple(w, past, i), triple(w, past + 3, i), triple(w, past + 6, i), triple(w, past + 9, i)),
        triple(w, LOAD, i), triple(w, LOAD + 3, i),
    )  # fmt: skip


@inlined
def _wrench(w: Array, law: int, i: int) -> Any:
    """Total wrench of one lane at the stage; of a pointwise section, after `sum_tubes`."""
    v, u, v_h, u_h = triple(w, STAGE, i), triple(w, STAGE + 3, i), triple(w, PAST, i), triple(w, PAST + 3, i)
    if law == LINEAR:
        return linear_wrench(six(w, AXIAL, i), six(w, SHEAR, i), six(w, OFFSET, i), w[LAG * LANES + i], v, u, v_h, u_h)
    return pointwise_wrench(w, i, w[C0 * LANES + i], v, u, v_h, u_h)


@inlined
def _sloped(w: Array, law: int, i: int) -> None:
    """Slopes of one lane's state at the stage."""
    n, m = _wrench(w, law, i)
    q_s, o_s, n_s, m_s = _balanced(w, i, n, m)
    v, u, v_hs, u_hs = triple(w, STAGE, i), triple(w, STAGE + 3, i), triple(w, PAST + 12, i), triple(w, PAST + 15, i)
    if law == LINEAR:
        lag = w[LAG * LANES + i]
        v_s, u_s = linear_slopes(six(w, AXIAL_INVERSE, i), six(w, SHEAR_INVERSE, i), lag, n_s, m_s, v_hs, u_hs)
    else:
        v_s, u_s = pointwise_slopes(w, i, w[C0 * LANES + i], v, u, n_s, m_s, v_hs, u_hs)
    put(w, SLOPE, i, v_s)
    put(w, SLOPE + 3, i, u_s)
    put(w, SLOPE + 6, i, q_s)
    put(w, SLOPE + 9, i, o_s)
    # h' = h u / 2 as quaternions (eq 9).
    h = (STAGE + 12) * LANES + i
    a, b, c, d = w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]
    w[(SLOPE + 12) * LANES + i] = -0.5 * (b * u[0] + c * u[1] + d * u[2])
    w[(SLOPE + 13) * LANES + i] = 0.5 * (a * u[0] + c * u[2] - d * u[1])
    w[(SLOPE + 14) * LANES + i] = 0.5 * (a * u[1] + d * u[0] - b * u[2])
    w[(SLOPE + 15) * LANES + i] = 0.5 * (a * u[2] + b * u[1] - c * u[0])


@leaf
def _slopes(w: Array, law: int, actuators: int, load: Array, loaded: bool, row: int) -> None:
    """The right-hand side: slopes along the arc length of the stage's state, all lanes."""
    if loaded:
        f0, couple0 = three(load, 6 * row), three(load, 6 * row + 3)
        for i in range(LANES):
            h = (STAGE + 12) * LANES + i
            d1, d2, d3 = rotation((w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]))
            f, couple = plus(f0, 1.0, triple(w, WEIGHT, i)), plus(couple0, 1.0, triple(w, WEIGHT + 3, i))
            put(w, LOAD, i, (dot(d1, f), dot(d2, f), dot(d3, f)))
            put(w, LOAD + 3, i, (dot(d1, couple), dot(d2, couple), dot(d3, couple)))
    if law == LINEAR:
        for i in range(LANES):
            _sloped(w, LINEAR, i)
    else:
        for i in range(3 * LANES):
            w[STRAINS * LANES + i] = w[(STAGE + 2) * LANES + i]
        sum_tubes(w, (actuators + 2) // 3)
        for i in range(LANES):
            _sloped(w, POINTWISE, i)


@inlined
def _recall(w: Array, past: Array) -> None:
    """The history at a node."""
    for i in range(HISTORY * LANES):
        w[PAST * LANES + i] = past[i]


@inlined
def _recall_between(w: Array, a: Array, b: Array) -> None:
    """The history half-way between two nodes, as `march.sample_history` finds it."""
    for c in range(12):
        for i in range(LANES):
            at, to = c * LANES + i, (12 + c) * LANES + i
            bent = 0.125 * w[STRIDE * LANES + i] * (a[to] - b[to])
            w[PAST * LANES + at] = 0.5 * (a[at] + b[at]) + bent
    for c in range(6):
        for i in range(LANES):
            at, to = c * LANES + i, (12 + c) * LANES + i
            w[PAST * LANES + to] = 1.5 / w[STRIDE * LANES + i] * (b[at] - a[at]) - 0.25 * (a[to] + b[to])


@leaf
def _march(
    w: Array, law: int, actuators: int, past: Array, moving: bool, load: Array, loaded: bool, first: int, last: int,
    states: Array, derivatives: Array,
) -> None:  # fmt: skip
    """Integrate the node's state, all lanes, from node `first` to node `last`, as `rod.integrate` does.

    past (N + 1, 192): history of velocities, strains and all their slopes at the nodes, of every lane, looked at when
    `moving`. At the arm's tip, the state and its slope are filled in too.
    """
    size, n = STATE * LANES, states.shape[0] - 1
    for j in range(first, last):
        for i in range(size):
            y = w[NODE * LANES + i]
            w[STAGE * LANES + i] = y
            w[GATHER * LANES + i] = y
            states[j, i] = y
        for k in range(4):
            row = 2 * j + (k + 1) // 2
            if moving and k == 1:
                _recall_between(w, past[j], past[j + 1])
            elif moving and k != 2:
                _recall(w, past[row // 2])
            _slopes(w, law, actuators, load, loaded, row)
            ahead = 1.0 if k == 2 else 0.5
            share = 1.0 / 6.0 if k in (0, 3) else 1.0 / 3.0
            if k == 0:
                for i in range(size):
                    derivatives[j, i] = w[SLOPE * LANES + i]
            for c in range(STATE):
                for i in range(LANES):
                    slope = w[STRIDE * LANES + i] * w[(SLOPE + c) * LANES + i]
                    w[(STAGE + c) * LANES + i] = w[(NODE + c) * LANES + i] + ahead * slope
                    w[(GATHER + c) * LANES + i] += share * slope
        for i in range(size):
            w[NODE * LANES + i] = w[GATHER * LANES + i]
    if last == n:
        for i in range(size):
            y = w[NODE * LANES + i]
            w[STAGE * LANES + i] = y
            states[n, i] = y
        # PAST holds the tip's history from the last stage.
        _slopes(w, law, actuators, load, loaded, 2 * n)
        for i in range(size):
            derivatives[n, i] = w[SLOPE * LANES + i]


@leaf
def _lacking(w: Array, law: int, c0: float, heavy: bool) -> None:
    """What each lane's tip lacks of what hangs on it, in the wrench's place; `shooting.tip_residual` lane by lane.

    After `_march`, which leaves the tubes' sums.
    """
    for i in range(LANES):
        n, m = _wrench(w, LINEAR, i) if law == LINEAR else _wrench(w, POINTWISE, i)
        h = (NODE + 12) * LANES + i
        d1, d2, d3 = rotation((w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]))
        force, moment, place = triple(w, END, i), triple(w, END + 3, i), triple(w, END + 10, i)
        f = (dot(d1, force), dot(d2, force), dot(d3, force))
        couple = (dot(d1, moment), dot(d2, moment), dot(d3, moment))
        if heavy:
            f, couple = cap(
                w, i, f, couple, w[(END + 6) * LANES + i], triple(w, END + 7, i), place, c0,
                triple(w, PAST + 6, i), triple(w, PAST + 9, i),
            )  # fmt: skip
        couple = plus(couple, 1.0, cross(place, f))
        pull = triple(w, PULL, i)
        couple = plus(couple, 1.0, cross(triple(w, PULL + 3, i), (dot(d1, pull), dot(d2, pull), dot(d3, pull))))
        put(w, WRENCH, i, plus(n, -1.0, f))
        put(w, WRENCH + 3, i, plus(m, -1.0, couple))


@leaf
def _eliminate(a: Array, b: Array) -> bool:
    """Solve a x = b (6, 6) for every row of b (P, 6), in place; False when singular."""
    n = 6
    for i in range(n):
        p, best = i, abs(a[i, i])
        for r in range(i + 1, n):
            if abs(a[r, i]) > best:
                p, best = r, abs(a[r, i])
        # Written so that a NaN is refused too.
        if not best > 1e-300:
            return False
        if p != i:
            for c in range(n):
                a[i, c], a[p, c] = a[p, c], a[i, c]
            for f in range(b.shape[0]):
                b[f, i], b[f, p] = b[f, p], b[f, i]
        over = 1.0 / a[i, i]
        for r in range(i + 1, n):
            share = a[r, i] * over
            for c in range(i + 1, n):
                a[r, c] -= share * a[i, c]
            for f in range(b.shape[0]):
                b[f, r] -= share * b[f, i]
    for f in range(b.shape[0]):
        for i in range(n - 1, -1, -1):
            total = b[f, i]
            for c in range(i + 1, n):
                total -= a[i, c] * b[f, c]
            b[f, i] = total / a[i, i]
    return True


@leaf
def press(
    works: Array, actuators: int, rest: Array, per_pressure: Array, free: Array, ends: Array, pressure: Array,
    hung: Array, pull: Array,
) -> None:  # fmt: skip
    """Write pressures (W, N, 8) and loads at the tip into the work arrays (W, size), lane by lane.

    rest (W, 6, 8), per_pressure (W, 6, N, 8), free (W, 8) and ends (W, 13, 8): as of `Problem`. hung (W, 6, 8): force
    and moment beyond that. pull (W, 6, 8): a part of the force whose lever turns with the tip, and the lever.
    """
    first = TRIO if actuators <= 3 else MORE
    for p in range(works.shape[0]):
        w = works[p]
        for c in range(6):
            for i in range(LANES):
                total = rest[p, c, i]
                for k in range(actuators):
                    total += per_pressure[p, c, k, i] * pressure[p, k, i]
                w[(OFFSET + c) * LANES + i] = total
                w[(END + c) * LANES + i] = ends[p, c, i] + hung[p, c, i]
                w[(PULL + c) * LANES + i] = pull[p, c, i]
        for k in range(actuators):
            for i in range(LANES):
                w[(first + PER_TUBE * k + 2) * LANES + i] = free[p, i] * pressure[p, k, i]


@leaf
def neighbours(
    works: Array, law: int, actuators: int, past: Array, load: Array, loaded: bool, c0: float, heavy: bool,
    segments: int, scale: Array, x: Array, room: Lanes, states: Array, derivatives: Array,
) -> bool:  # fmt: skip
    """One pass from the solved arm x (N + 1, 16): fills states, derivatives (W, N + 1, 128) and the shares of them.

    A neighbour is its lane plus, in segment s, its shares of lanes 1 to 6, all against lane 0. Segments are joined as
    in `shooting.newton`. past (W, N + 1, 192), at rest not looked at. False when no answer is found.
    """
    directions, triangle, along, parts = room.directions, room.triangle, room.along, room.parts
    n, count = x.shape[0] - 1, parts.shape[0]
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
            _march(
                w, law, actuators, past[p], c0 > 0.0, load, loaded, s * per, (s + 1) * per, states[p], derivatives[p]
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
        _lacking(works[p], law, c0, heavy)
    for i in range(6):
        at = (WRENCH + i) * LANES
        for k in range(6):
            room.matrix[i, k] = (first[at + 1 + k] - first[at]) * (1.0 / STEP)
        for f in range(count):
            lane = FIRST + f
            room.right[f, i] = first[at] - works[lane // LANES, at + lane % LANES]
    if not _eliminate(room.matrix, room.right):
        return False
    for f in range(count):
        p, i, right = (FIRST + f) // LANES, (FIRST + f) % LANES, room.right[f]
        for s in range(segments - 1, -1, -1):
            for k in range(6):
                room.shares[s, p, k, i] = right[k] * (1.0 / STEP)
            if s > 0:
                for k in range(5, -1, -1):
                    total = right[k] - along[s, f, k]
                    for c in range(k + 1, 6):
                        total -= triangle[s, k, c] * right[c]
                    right[k] = total / triangle[s, k, k]
    return True


@leaf
def _places(w: Array, states: Array, derivatives: Array, tip: Array, place: Array) -> None:
    """Tip (3) and turn (3) of every lane into place (6, 8), as `axis.axis` finds the tip.

    The turn is the rotation vector [rad] in the base frame by which a lane's tip is turned against the state `tip`
    (16,), to first order.
    """
    n = states.shape[0] - 1
    for i in range(9 * LANES):
        w[GATHER * LANES + i] = 0.0
    for j in range(n + 1):
        for i in range(STATE * LANES):
            w[NODE * LANES + i] = states[j, i]
        for i in range(6 * LANES):
            w[SLOPE * LANES + i] = derivatives[j, i]
        for i in range(LANES):
            q = (NODE + 12) * LANES + i
            d1, d2, d3 = rotation((w[q], w[q + LANES], w[q + 2 * LANES], w[q + 3 * LANES]))
            strain = triple(w, NODE, i)
            g = plus(triple(w, SLOPE, i), 1.0, cross(triple(w, NODE + 3, i), strain))
            at, was, turned = triple(w, GATHER, i), triple(w, GATHER + 3, i), triple(w, GATHER + 6, i)
            speed = plus(plus((strain[0] * d1[0], strain[0] * d1[1], strain[0] * d1[2]), strain[1], d2), strain[2], d3)
            turn = plus(plus((g[0] * d1[0], g[0] * d1[1], g[0] * d1[2]), g[1], d2), g[2], d3)
            h = w[STRIDE * LANES + i] if j > 0 else 0.0
            at = plus(plus(at, 0.5 * h, plus(was, 1.0, speed)), h * h / 12.0, plus(turned, -1.0, turn))
            put(w, GATHER, i, at)
            put(w, GATHER + 3, i, speed)
            put(w, GATHER + 6, i, turn)
    a0, b0, c0, e0 = tip[12], tip[13], tip[14], tip[15]
    over = 2.0 / (a0 * a0 + b0 * b0 + c0 * c0 + e0 * e0)
    for i in range(LANES):
        q = (NODE + 12) * LANES + i
        a, b, c, e = w[q], w[q + LANES], w[q + 2 * LANES], w[q + 3 * LANES]
        d1, d2, _ = rotation((a, b, c, e))
        cx, cy = w[CENTRE * LANES + i], w[(CENTRE + 1) * LANES + i]
        at = plus(plus(triple(w, GATHER, i), -cx, d1), -cy, d2)
        place[0, i], place[1, i], place[2, i] = at[0] + cx, at[1] + cy, at[2]
        place[3, i] = over * (-a * b0 + b * a0 - c * e0 + e * c0)
        place[4, i] = over * (-a * c0 + c * a0 - e * b0 + b * e0)
        place[5, i] = over * (-a * e0 + e * a0 - b * c0 + c * b0)


@leaf
def _answers(x: Array, works: Array, room: Lanes, steps: Array, by: Array) -> None:
    """How tip and turn answer (P, 6) to each neighbour's change of size steps (P,), after `neighbours` in one go."""
    n = x.shape[0] - 1
    for p in range(works.shape[0]):
        _places(works[p], room.states[0, p], room.derivatives[0, p], x[n], room.place[p])
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            total = room.place[p, c, i] - room.place[0, c, 0]
            for k in range(6):
                total += room.shares[0, p, k, i] * (room.place[0, c, 1 + k] - room.place[0, c, 0])
            by[f, c] = total / steps[f]


@leaf
def _lever(x: Array, pull: Array, tip: Array, before: Array, share: float) -> float:
    """Move the tip's load from the pull's moment `before` (3,) by a share towards that of its lever now; how far off.

    pull (6, 8): force and lever, of which lane 0 counts. The moment is about the axis' end.
    """
    h = x[x.shape[0] - 1]
    d1, d2, d3 = rotation((h[12], h[13], h[14], h[15]))
    at = (pull[3, 0], pull[4, 0], pull[5, 0])
    arm = plus(plus((at[0] * d1[0], at[0] * d1[1], at[0] * d1[2]), at[1], d2), at[2], d3)
    moment = cross(arm, (pull[0, 0], pull[1, 0], pull[2, 0]))
    largest = 0.0
    for c in range(3):
        change = moment[c] - before[c]
        largest = max(largest, abs(change))
        tip[3 + c] += share * change
        before[c] += share * change
    return largest


@kernel
def resting(
    work: Array, works: Array, law: int, actuators: int, rest: Array, per_pressure: Array, free: Array, rests: Array,
    per_pressures: Array, frees: Array, ends: Array, pressure: Array, hung: Array, pull: Array, load: Array,
    loaded: bool, loaded_lanes: bool, heavy: bool, tip: Array, length: float, scale: Array, centre: Array,
    tolerance: float, solver: Room, room: Lanes, steps: Array, place: Array, turned: Array, by: Array, good: Array,
) -> None:  # fmt: skip
    """One equilibrium per row of pressure (K, W, N, 8), and how its tip answers to each neighbour's change.

    The arm: work (R, size), rest (R, 6), per_pressure (R, 6, N), free (R,), tip (13,). The lanes: works (R, W, size)
    and as `press` takes them, with R before. R and the rows of hung and pull are K, or 1 for the same everywhere.
    Fills place (K, 3), turned (K, 3, 3), by (K, P, 6) and good (K,).
    """
    n = solver.x.shape[0] - 1
    p, turns, v, u = np.empty((n + 1, 3)), np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3))
    row, here, lever = np.empty(actuators), tip.copy(), np.empty(3)
    nothing = np.zeros((works.shape[1], 1, 1))
    segments = room.shares.shape[0]
    for t in range(pressure.shape[0]):
        r = t % work.shape[0]
        hangs, pulls = hung[t % hung.shape[0]], pull[t % pull.shape[0]]
        for k in range(actuators):
            row[k] = pressure[t, 0, k, 0]
        for c in range(6):
            here[c] = tip[c] + hangs[0, c, 0]
        pulled = 0.0
        for c in range(3):
            pulled += abs(pulls[0, c, 0])
            lever[c] = 0.0
        if pulled > 0.0:
            for c in range(STATE):
                solver.x[n, c] = 1.0 if c == 12 else 0.0
            _lever(solver.x, pulls[0], here, lever, 1.0)
        solved = equilibrium(
            work[r], law, actuators, rest[r], per_pressure[r], free[r], row, load, loaded, here, length, scale, solver,
            tolerance,
        )  # fmt: skip
        if pulled > 0.0:
            still, share, last = False, 1.0, np.inf
            for _ in range(LEVER_PASSES):
                if solved > 0 and not still:
                    off = _lever(solver.x, pulls[0], here, lever, share)
                    still = off <= LEVER_STILL * pulled + NO_MOMENT
                    # A strong pull turns the tip by more than the lever was off: then smaller steps.
                    share = max(0.1, 0.5 * share) if off > 0.7 * last else share
                    last = off
                    if not still:
                        solved = newton(
                            work[r], law, actuators, load, loaded, here, 0.0, length, segments, scale, solver,
                            tolerance, 20.0,
                        )  # fmt: skip
            if not still:
                solved = -1
        good[t] = solved > 0
        if solved > 0:
            axis(solver.x, solver.slope, length, centre, p, turns, v, u)
            place[t] = p[n]
            turned[t] = turns[n]
            if steps.shape[0] > 0:
                press(works[r], actuators, rests[r], per_pressures[r], frees[r], ends, pressure[t], hangs, pulls)
                found = neighbours(
                    works[r], law, actuators, nothing, load, loaded_lanes, 0.0, heavy, segments, scale,
                    solver.x, room, room.states[0], room.derivatives[0],
                )  # fmt: skip
                if found:
                    _answers(solver.x, works[r], room, steps, by[t])
                else:
                    by[t] = np.nan
        else:
            place[t] = np.nan
            turned[t] = np.nan
            by[t] = np.nan


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
def _combine(x: Array, slope: Array, segments: int, room: Lanes, states: Array, derivatives: Array) -> None:
    """Turn the lanes, after `neighbours`, into the solved neighbours; all other lanes become the arm x, slope."""
    n, count = x.shape[0] - 1, room.parts.shape[0]
    per = n // segments
    for j in range(n + 1):
        s = min(j // per, segments - 1)
        for p in range(states.shape[0] - 1, -1, -1):
            _join(states[p, j], states[0, j], room.shares[s, p], x[j], p, count, STATE)
            _join(derivatives[p, j], derivatives[0, j], room.shares[s, p], slope[j], p, count, 12)


@leaf
def _moved(x: Array, works: Array, room: Lanes, states: Array, derivatives: Array, steps: Array, by: Array) -> None:
    """How tip and turn answer (P, 6) to each neighbour's change, after `_combine`."""
    n = x.shape[0] - 1
    for p in range(works.shape[0]):
        _places(works[p], states[p], derivatives[p], x[n], room.place[p])
    for f in range(steps.shape[0]):
        p, i = (FIRST + f) // LANES, (FIRST + f) % LANES
        for c in range(6):
            by[f, c] = (room.place[p, c, i] - room.place[0, c, 0]) / steps[f]


@leaf
def _remember(past: Array, room: Lanes, last: int, a: float, b: float, d: float) -> None:
    """The history (eq 26) of the next time step: a, b times the last two solutions, d times this history."""
    half = 12 * LANES
    for k in range(past.shape[0]):
        for j in range(past.shape[1]):
            x, x_before = room.states[last, k, j], room.states[1 - last, k, j]
            slope, slope_before = room.derivatives[last, k, j], room.derivatives[1 - last, k, j]
            for i in range(half):
                past[k, j, i] = a * x[i] + b * x_before[i] + d * past[k, j, i]
            for i in range(half):
                past[k, j, half + i] = a * slope[i] + b * slope_before[i] + d * past[k, j, half + i]


@kernel
def moving(
    w: Array, law: int, actuators: int, rest: Array, per_pressure: Array, free: float, before: Array, load: Array,
    loaded: bool, length: float, segments: int, scale: Array, scheme: Array, levels: Array, trail: Array, x: Array,
    slope: Array, solver: Room, tolerance: float, centre: Array, tip: Array, resting_works: Array,
    resting_rests: Array, resting_per_pressures: Array, still: Array, works: Array, rests: Array,
    per_pressures: Array, frees: Array, ends: Array, pressure: Array, hung: Array, loaded_lanes: bool, heavy: bool,
    past: Array, room: Lanes, steps: Array, every: int, place: Array, turned: Array, by: Array, good: Array,
) -> None:  # fmt: skip
    """A motion from rest by BDF-alpha, and how its tip answers to each neighbour's change.

    The arm as `axis.motion` takes it, at rest in x, slope; the lanes as `press` takes them, `resting_..` and scale
    `still` of the arm at rest. pressure (1 + T, W, N, 8): at rest, then step by step. hung (1 + T, 3): force on the
    tip. past (W, N + 1, 192): room for the lanes' history. Of every so many steps it fills place, turned, by
    (1 + T / every, ..) and good.
    """
    n, count = x.shape[0] - 1, works.shape[0]
    p, turns, v, u = np.empty((n + 1, 3)), np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3))
    row, here, nothing = np.empty(actuators), tip.copy(), np.zeros((count, 6, LANES))
    hangs = np.zeros((count, 6, LANES))
    c0, c1, c2, d1 = scheme[0], scheme[1], scheme[2], scheme[4]
    followed, now = True, 0
    for t in range(pressure.shape[0]):
        for c in range(3):
            here[c] = tip[c] + hung[t, c]
            for k in range(count):
                for i in range(LANES):
                    hangs[k, c, i] = hung[t, c]
        solved = 1
        if t == 0:
            press(
                resting_works, actuators, resting_rests, resting_per_pressures, frees, ends, pressure[t], hangs, nothing
            )
            followed = neighbours(
                resting_works, law, actuators, past, load, loaded_lanes, 0.0, heavy, segments, still, x, room,
                room.states[0], room.derivatives[0],
            )  # fmt: skip
            _combine(x, slope, segments, room, room.states[0], room.derivatives[0])
            room.states[1] = room.states[0]
            room.derivatives[1] = room.derivatives[0]
            # An arm at rest has no rates: y^h = -c0 y.
            _remember(past, room, now, -c0, 0.0, 0.0)
        else:
            for k in range(actuators):
                row[k] = pressure[t, 0, k, 0]
            solved = advance(
                w, law, actuators, rest, per_pressure, free, before, row, load, loaded, here, length, segments, scale,
                scheme, levels, trail, x, slope, solver, tolerance,
            )  # fmt: skip
            if solved > 0 and followed:
                # y_t of the last step is c0 times its solution plus its history.
                _remember(past, room, now, c1 + d1 * c0, c2, d1)
                now = 1 - now
                press(works, actuators, rests, per_pressures, frees, ends, pressure[t], hangs, nothing)
                followed = neighbours(
                    works, law, actuators, past, load, loaded_lanes, c0, heavy, segments, scale, x, room,
                    room.states[now], room.derivatives[now],
                )  # fmt: skip
                _combine(x, slope, segments, room, room.states[now], room.derivatives[now])
        if t % every == 0:
            at = t // every
            good[at] = solved > 0
            axis(x, slope, length, centre, p, turns, v, u)
            place[at] = p[n]
            turned[at] = turns[n]
            if followed:
                _moved(x, works, room, room.states[now], room.derivatives[now], steps, by[at])
            else:
                by[at] = np.nan
