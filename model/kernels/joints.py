"""Ends of the segments: the load at the tip, and the couplings between two segments.

A coupling is a rigid body. Over it the wrench changes by its load, the position of the line by the lever d between the
two lines, and the velocity by w x d. Strains jump with the section; those of the next segment follow from the wrench.
"""

from __future__ import annotations

from typing import Any

from model.kernels.law import Walls
from model.kernels.layout import C0, ECCENTRIC_FORCE, FOURTH, JOINT, LANES, NODE, RATE, SLOPE, STAGE, TIP_LOAD, WRENCH
from model.kernels.rod import Past, own_past, strain_changes, total_wrench, wrench
from model.kernels.vec3 import Triple, cross, dot, inlined, leaf, plus, put, rotation, triple

Array = Any

MOST_ITERATIONS = 30
# Of an update of the strains, in units of `scale`: Newton's method leaves about its square.
TOLERANCE = 1e-8


@inlined
def has_inertia(end: Array) -> bool:
    """Whether cap or coupling has inertia, by the load (19,) at the end of a segment."""
    return end[6] > 0.0 or end[7] > 0.0 or end[8] > 0.0 or end[9] > 0.0  # type: ignore[no-any-return]


@inlined
def _subtract_inertia(
    w: Array, i: int, f: Triple, couple: Triple, place: Triple, c0: float, q_h: Triple, o_h: Triple
) -> Any:
    """Subtract the inertia of cap or coupling from the force f and the couple at the end, in the section frame."""
    mass, inertia = w[(TIP_LOAD + 6) * LANES + i], triple(w, TIP_LOAD + 7, i)
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
def end_wrench(w: Array, walls: Walls, past: Past, own: bool, inertia: bool) -> None:
    """Wrench at the end of a segment that its load does not balance [N, N m], written in place of the wrench.

    At the tip, the residual of the boundary condition (eqs 23-25, 28); at a joint, the wrench that the next segment
    carries. Call it after the stage at the end, which sums the tubes; past and own as of `rod.stage`. The load stands
    at TIP_LOAD. inertia: whether cap or coupling has inertia.
    """
    for i in range(LANES):
        _, _, q_h, o_h, v_p, u_p, _, _ = own_past(w, walls, i) if own else past
        n, m = wrench(w, i, NODE, v_p, u_p)
        h = (NODE + 12) * LANES + i
        d1, d2, d3 = rotation((w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]))
        force, moment, place = triple(w, TIP_LOAD, i), triple(w, TIP_LOAD + 3, i), triple(w, TIP_LOAD + 10, i)
        eccentric, point = triple(w, ECCENTRIC_FORCE, i), triple(w, ECCENTRIC_FORCE + 3, i)
        f = (dot(d1, force), dot(d2, force), dot(d3, force))
        couple = (dot(d1, moment), dot(d2, moment), dot(d3, moment))
        couple = plus(couple, 1.0, cross(point, (dot(d1, eccentric), dot(d2, eccentric), dot(d3, eccentric))))
        if inertia:
            f, couple = _subtract_inertia(w, i, f, couple, place, w[C0 * LANES + i], q_h, o_h)
        couple = plus(couple, 1.0, cross(place, f))
        put(w, WRENCH, i, plus(n, -1.0, f))
        put(w, WRENCH + 3, i, plus(m, -1.0, couple))


@leaf
def cross_joint(w: Array, after: Array, walls: Walls, past: Past, own: bool, guess: Array, scale: Array) -> None:
    """Carry all lanes from the end of a segment, at NODE of w, to the start of the next one, at NODE of `after`.

    Call it after `end_wrench`. past, own: history at the start of the next segment, as of `rod.stage`. guess (16,): a
    state near that start, from which Newton's method finds the strains.
    """
    for i in range(LANES):
        d, n = triple(w, JOINT, i), triple(w, WRENCH, i)
        put(after, FOURTH, i, n)
        put(after, FOURTH + 3, i, plus(triple(w, WRENCH + 3, i), -1.0, cross(d, n)))
        turning = triple(w, NODE + 9, i)
        put(after, NODE + 6, i, plus(triple(w, NODE + 6, i), 1.0, cross(turning, d)))
        put(after, NODE + 9, i, turning)
        for c in range(12, 16):
            after[(NODE + c) * LANES + i] = w[(NODE + c) * LANES + i]
        for c in range(6):
            after[(STAGE + c) * LANES + i] = guess[c]
    for _ in range(MOST_ITERATIONS):
        total_wrench(after, walls, past, own)
        for i in range(LANES):
            for c in range(6):
                after[(RATE + c) * LANES + i] = after[(FOURTH + c) * LANES + i] - after[(WRENCH + c) * LANES + i]
        strain_changes(after)
        largest = 0.0
        for c in range(6):
            for i in range(LANES):
                change = after[(SLOPE + c) * LANES + i]
                after[(STAGE + c) * LANES + i] += change
                largest = max(largest, abs(change) / scale[c])
        if largest < TOLERANCE:
            break
    for c in range(6):
        for i in range(LANES):
            after[(NODE + c) * LANES + i] = after[(STAGE + c) * LANES + i]
