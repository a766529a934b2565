"""Right-hand side of the rod (eqs 7-13) and its integration along the arc length.

All quantities are in the section frame. The total wrench is that of the walls minus the push of the pressures. Its
balance has no pressure term,

    n' = -u x n + rho A (q_t + w x q) - f,      m' = -u x m - v x n + rho (J w_t + w x J w) - l,

which is eqs 12 and 13 with the pressure as part of the section law. Time derivatives are y_t = c0 y + y^h (eq 26).
"""

from __future__ import annotations

from typing import Any

from model.kernels.arguments import Rod
from model.kernels.law import Walls, branched
from model.kernels.layout import (
    AXIAL,
    AXIAL_INVERSE,
    C0,
    FOURTH,
    INERTIA,
    LAG,
    LANES,
    LINE_DENSITY,
    LOAD,
    NODE,
    OFFSET,
    OWN_LOAD,
    PAST,
    POINTWISE,
    RATE,
    SHEAR,
    SHEAR_INVERSE,
    SLOPE,
    STAGE,
    STEP_LENGTH,
    STRAINS,
    THIRD,
    WALL_FORCES,
    WRENCH,
)
from model.kernels.pointwise_section import (
    pointwise_slopes,
    pointwise_wrench,
    sum_other_trios,
    sum_tubes,
    tube_responses,
)
from model.kernels.vec3 import Six, Triple, cross, dot, inlined, leaf, plus, put, rotation, six, three, times, triple

Array = Any
Past = tuple[Triple, Triple, Triple, Triple, Triple, Triple, Triple, Triple]


@inlined
def pointwise(w: Array) -> bool:
    """Whether each tube of the segment follows the law at every point; else its stiffness is constant."""
    return w[POINTWISE * LANES] > 0.0  # type: ignore[no-any-return]


@inlined
def compatibility(v: Triple, u: Triple, q: Triple, o: Triple, v_t: Triple, u_t: Triple) -> tuple[Triple, Triple]:
    """Arc-length derivatives of the velocities q, o (eq 11)."""
    return plus(plus(v_t, 1.0, cross(o, v)), -1.0, cross(u, q)), plus(u_t, -1.0, cross(u, o))


@inlined
def inertia(
    mass: float, inertias: tuple[float, float, float, float], q: Triple, o: Triple, q_t: Triple, o_t: Triple
) -> tuple[Triple, Triple]:
    """Rate of momentum and angular momentum per length. inertias: rho J as 11, 22, 12, 33."""
    j11, j22, j12, j33 = inertias
    spin = (j11 * o[0] + j12 * o[1], j12 * o[0] + j22 * o[1], j33 * o[2])
    spun = (j11 * o_t[0] + j12 * o_t[1], j12 * o_t[0] + j22 * o_t[1], j33 * o_t[2])
    force = plus(q_t, 1.0, cross(o, q))
    return (mass * force[0], mass * force[1], mass * force[2]), plus(spun, 1.0, cross(o, spin))


@inlined
def balance(v: Triple, u: Triple, n: Triple, m: Triple, force: Triple, couple: Triple) -> tuple[Triple, Triple]:
    """Arc-length derivatives of the wrench n, m (eqs 12, 13); force, couple: inertia minus load, per length."""
    return plus(cross(n, u), 1.0, force), plus(plus(cross(m, u), 1.0, cross(n, v)), 1.0, couple)


@inlined
def _advance(w: Array, k: int, slope: float, to: int, step_share: float) -> None:
    """Advance one quantity by its derivative to the next stage of RK4 or to the next node. k: its index in a state.

    The next node is (second + 2 third + fourth stage - node) / 3 + h / 6 slope: RK4 without an accumulated sum.
    """
    node = w[NODE * LANES + k]
    if to == NODE:
        apart = (w[STAGE * LANES + k] - node) + w[FOURTH * LANES + k] + 2.0 * w[THIRD * LANES + k]
        w[NODE * LANES + k] = (1.0 / 3.0) * apart + step_share * slope
    else:
        w[to * LANES + k] = node + step_share * slope


@inlined
def _advance_three(w: Array, k: int, slope: Triple, to: int, step_share: float) -> None:
    _advance(w, k, slope[0], to, step_share)
    _advance(w, k + LANES, slope[1], to, step_share)
    _advance(w, k + 2 * LANES, slope[2], to, step_share)


@inlined
def _advance_and_store(w: Array, c: int, i: int, slope: Triple, to: int, step_share: float) -> None:
    """Advance three quantities of lane i from index c on; the derivatives of the first stage are kept."""
    if to == STAGE:
        put(w, SLOPE + c, i, slope)
    _advance_three(w, c * LANES + i, slope, to, step_share)


@inlined
def _advance_motion(w: Array, i: int, past: Past, at: int, to: int, step_share: float) -> tuple[Triple, Triple]:
    """Advance velocities and orientation, whose derivative is h u / 2 as quaternions (eq 9).

    Returns force and couple for the balance of the wrench: inertia minus load, per length.
    """
    v, u, q, o = triple(w, at, i), triple(w, at + 3, i), triple(w, at + 6, i), triple(w, at + 9, i)
    v_h, u_h, q_h, o_h, _, _, _, _ = past
    c0, j = w[C0 * LANES + i], INERTIA * LANES + i
    q_s, o_s = compatibility(v, u, q, o, plus(v_h, c0, v), plus(u_h, c0, u))
    force, couple = inertia(
        w[LINE_DENSITY * LANES + i], (w[j], w[j + LANES], w[j + 2 * LANES], w[j + 3 * LANES]), q, o,
        plus(q_h, c0, q), plus(o_h, c0, o),
    )  # fmt: skip
    h = (at + 12) * LANES + i
    a, b, c, d = w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]
    _advance(w, 12 * LANES + i, -0.5 * (b * u[0] + c * u[1] + d * u[2]), to, step_share)
    h_s = (0.5 * (a * u[0] + c * u[2] - d * u[1]), 0.5 * (a * u[1] + d * u[0] - b * u[2]),
           0.5 * (a * u[2] + b * u[1] - c * u[0]))  # fmt: skip
    _advance_three(w, 13 * LANES + i, h_s, to, step_share)
    _advance_and_store(w, 6, i, q_s, to, step_share)
    _advance_and_store(w, 9, i, o_s, to, step_share)
    return plus(force, -1.0, triple(w, LOAD, i)), plus(couple, -1.0, triple(w, LOAD + 3, i))


@inlined
def linear_wrench(axial: Six, shear: Six, offset: Six, lag: float, v: Triple, u: Triple, v_p: Triple, u_p: Triple):  # type: ignore[no-untyped-def]
    """Total wrench of the strains for a constant stiffness, coupled by the positions of the tubes (eqs 15, 16, 20).

    For viscous walls with time tau the blocks hold (1 + tau c0) times the stiffness, and lag is tau / (1 + tau c0).
    v_p, u_p: past strains of the walls; without Maxwell branches the history v^h, u^h.
    """
    e, g = plus(v, lag, v_p), plus(u, lag, u_p)
    a = times(axial, (e[2], g[0], g[1]))
    b = times(shear, (e[0], e[1], g[2]))
    return (offset[0] + b[0], offset[1] + b[1], offset[2] + a[0]), (
        offset[3] + a[1],
        offset[4] + a[2],
        offset[5] + b[2],
    )


@inlined
def linear_slopes(axial_inverse: Six, shear_inverse: Six, lag: float, n: Triple, m: Triple, v_p: Triple, u_p: Triple):  # type: ignore[no-untyped-def]
    """Strain derivatives for the wrench derivatives n, m; v_p, u_p: derivatives of the past strains."""
    a = times(axial_inverse, (n[2], m[0], m[1]))
    b = times(shear_inverse, (n[0], n[1], m[2]))
    return plus((b[0], b[1], a[0]), -lag, v_p), plus((a[1], a[2], b[2]), -lag, u_p)


@inlined
def past_of(history: Array, walls_past: Array, size: int, at: int) -> Past:
    """History of v, u, q, w at offset `at`; past strains v, u of the walls, and their derivatives `size` further on."""
    return (
        three(history, at), three(history, at + 3), three(history, at + 6), three(history, at + 9),
        three(walls_past, at), three(walls_past, at + 3),
        three(walls_past, size + at), three(walls_past, size + at + 3),
    )  # fmt: skip


@inlined
def own_past(w: Array, walls: Walls, i: int) -> Past:
    """The same of one lane with a history of its own."""
    at = PAST + 18 if branched(walls.law) else PAST
    return (
        triple(w, PAST, i), triple(w, PAST + 3, i), triple(w, PAST + 6, i), triple(w, PAST + 9, i),
        triple(w, at, i), triple(w, at + 3, i), triple(w, PAST + 12, i), triple(w, PAST + 15, i),
    )  # fmt: skip


@inlined
def _linear_stage(w: Array, walls: Walls, past: Past, own: bool, at: int, to: int, step_share: float) -> None:
    """Stage of RK4 for a constant stiffness, all lanes: from the state at `at` to the state at `to`."""
    for i in range(LANES):
        here = own_past(w, walls, i) if own else past
        _, _, _, _, v_p, u_p, v_ps, u_ps = here
        step = step_share * w[STEP_LENGTH * LANES + i]
        v, u, lag = triple(w, at, i), triple(w, at + 3, i), w[LAG * LANES + i]
        n, m = linear_wrench(six(w, AXIAL, i), six(w, SHEAR, i), six(w, OFFSET, i), lag, v, u, v_p, u_p)
        force, couple = _advance_motion(w, i, here, at, to, step)
        n_s, m_s = balance(v, u, n, m, force, couple)
        v_s, u_s = linear_slopes(six(w, AXIAL_INVERSE, i), six(w, SHEAR_INVERSE, i), lag, n_s, m_s, v_ps, u_ps)
        _advance_and_store(w, 0, i, v_s, to, step)
        _advance_and_store(w, 3, i, u_s, to, step)


@inlined
def _sum_other_trios(w: Array, walls: Walls, at: int) -> None:
    if walls.tubes > 3:
        for i in range(LANES):
            put(w, STRAINS, i, triple(w, at + 2, i))
        sum_other_trios(w, walls)


@inlined
def _pointwise_stage(w: Array, walls: Walls, past: Past, own: bool, at: int, to: int, step_share: float) -> None:
    """Stage of RK4 for tubes that each follow the law at their own position, as `_linear_stage`.

    The roots and divisions of the tubes come first, so that independent arithmetic fills their latency.
    """
    _sum_other_trios(w, walls, at)
    for i in range(LANES):
        here = own_past(w, walls, i) if own else past
        _, _, _, _, v_p, u_p, v_ps, u_ps = here
        step = step_share * w[STEP_LENGTH * LANES + i]
        v, u, c0 = triple(w, at, i), triple(w, at + 3, i), w[C0 * LANES + i]
        responses = tube_responses(w, walls, i, v[2], u[0], u[1])
        force, couple = _advance_motion(w, i, here, at, to, step)
        sum_tubes(w, i, responses, WALL_FORCES)
        n, m = pointwise_wrench(w, i, c0, v, u, v_p, u_p)
        n_s, m_s = balance(v, u, n, m, force, couple)
        v_s, u_s = pointwise_slopes(w, i, c0, v, u, n_s, m_s, v_ps, u_ps)
        _advance_and_store(w, 0, i, v_s, to, step)
        _advance_and_store(w, 3, i, u_s, to, step)


@inlined
def _rotate_load(w: Array, load: Array, own: bool, row: int, at: int) -> None:
    """Rotate a distributed load (force and moment per metre, base frame) into the section frame."""
    f, couple = three(load, 6 * row), three(load, 6 * row + 3)
    for i in range(LANES):
        force = plus(f, 1.0, triple(w, OWN_LOAD, i)) if own else f
        moment = plus(couple, 1.0, triple(w, OWN_LOAD + 3, i)) if own else couple
        h = (at + 12) * LANES + i
        d1, d2, d3 = rotation((w[h], w[h + LANES], w[h + 2 * LANES], w[h + 3 * LANES]))
        put(w, LOAD, i, (dot(d1, force), dot(d2, force), dot(d3, force)))
        put(w, LOAD + 3, i, (dot(d1, moment), dot(d2, moment), dot(d3, moment)))


@inlined
def wrench(w: Array, i: int, at: int, v_p: Triple, u_p: Triple) -> tuple[Triple, Triple]:
    """Total wrench of one lane with its state at `at`; of a pointwise section, after `sum_tubes`."""
    v, u = triple(w, at, i), triple(w, at + 3, i)
    if not pointwise(w):
        return linear_wrench(six(w, AXIAL, i), six(w, SHEAR, i), six(w, OFFSET, i), w[LAG * LANES + i], v, u, v_p, u_p)  # type: ignore[no-any-return]
    return pointwise_wrench(w, i, w[C0 * LANES + i], v, u, v_p, u_p)  # type: ignore[no-any-return]


@inlined
def total_wrench(w: Array, walls: Walls, past: Past, own: bool) -> None:
    """Total wrench at STAGE, all lanes; past and own as of `stage`."""
    if pointwise(w):
        _sum_other_trios(w, walls, STAGE)
        for i in range(LANES):
            v3, u1, u2 = triple(w, STAGE + 2, i)
            sum_tubes(w, i, tube_responses(w, walls, i, v3, u1, u2), WALL_FORCES)
    for i in range(LANES):
        _, _, _, _, v_p, u_p, _, _ = own_past(w, walls, i) if own else past
        n, m = wrench(w, i, STAGE, v_p, u_p)
        put(w, WRENCH, i, n)
        put(w, WRENCH + 3, i, m)


@leaf
def resting_wrench(w: Array, walls: Walls) -> None:
    """Total wrench at STAGE, all lanes, of an arm without history."""
    zero = (0.0, 0.0, 0.0)
    total_wrench(w, walls, (zero, zero, zero, zero, zero, zero, zero, zero), False)


@leaf
def strain_changes(w: Array) -> None:
    """Changes of the strains at STAGE that change the wrench by the values at RATE, to first order.

    For a pointwise section call `total_wrench` first, which sums the tubes.
    """
    zero = (0.0, 0.0, 0.0)
    for i in range(LANES):
        n, m = triple(w, RATE, i), triple(w, RATE + 3, i)
        if not pointwise(w):
            v_s, u_s = linear_slopes(six(w, AXIAL_INVERSE, i), six(w, SHEAR_INVERSE, i), 0.0, n, m, zero, zero)
        else:
            v, u = triple(w, STAGE, i), triple(w, STAGE + 3, i)
            v_s, u_s = pointwise_slopes(w, i, w[C0 * LANES + i], v, u, n, m, zero, zero)
        put(w, SLOPE, i, v_s)
        put(w, SLOPE + 3, i, u_s)


@inlined
def stage(rod: Rod, w: Array, past: Past, own: bool, row: int, at: int, to: int, step_share: float) -> None:
    """Stage of RK4 with the work array w of a segment, all lanes: from the state at `at` to the state at `to`.

    step_share: of a step between them. past: the history that all lanes share; with `own`, each lane has its own at
    PAST, and a load of its own. Shared numbers are read before the loops over the lanes, otherwise the compiler does
    not vectorise these.
    """
    if rod.loaded:
        _rotate_load(w, rod.load, own, row, at)
    if not pointwise(w):
        _linear_stage(w, rod.walls, past, own, at, to, step_share)
    else:
        _pointwise_stage(w, rod.walls, past, own, at, to, step_share)
