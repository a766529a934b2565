"""The section whose tube_responses each follow a law at their own place (section.py derives what is summed)."""

from __future__ import annotations

from typing import Any

from model.kernels.law import Walls, respond
from model.kernels.layout import (
    ALL_TRIOS,
    AXIAL,
    LANES,
    LAW,
    OFFSET,
    OTHER_TRIOS,
    PER_TRIO,
    PER_TUBE,
    SECANTS,
    SHEAR,
    STIFFNESS_SLOPES,
    STRAINS,
    SUMS,
    TANGENTS,
    TRIO,
    TUBE,
    WALL_FORCES,
)
from model.kernels.vec3 import Triple, inlined, leaf, plus, put, six, times, triple

Array = Any


@inlined
def _add_products(total: float, a: Triple, b: Triple) -> float:
    """total + a . b."""
    return total + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def tube_responses(w: Array, walls: Walls, i: int, v3: float, u1: float, u2: float) -> Any:
    """Responses of the law for the three tubes at TRIO of lane i."""
    at = LAW * LANES + i
    constants = w[at], w[at + LANES], w[at + 2 * LANES], w[at + 3 * LANES]
    x1, y1, free1 = triple(w, TRIO, i)
    x2, y2, free2 = triple(w, TRIO + PER_TUBE, i)
    x3, y3, free3 = triple(w, TRIO + 2 * PER_TUBE, i)
    share = (TRIO + 3) * LANES + i
    share1, share2, share3 = w[share], w[share + PER_TUBE * LANES], w[share + 2 * PER_TUBE * LANES]
    f1, t1, k1, e1 = respond(walls.law, v3 - 1.0 + y1 * u1 - x1 * u2 - free1, constants, share1)
    f2, t2, k2, e2 = respond(walls.law, v3 - 1.0 + y2 * u1 - x2 * u2 - free2, constants, share2)
    f3, t3, k3, e3 = respond(walls.law, v3 - 1.0 + y3 * u1 - x3 * u2 - free3, constants, share3)
    return (f1, f2, f3), (t1, t2, t3), (k1, k2, k3), (e1, e2, e3)


@inlined
def _of_tubes(w: Array, i: int, c: int) -> Triple:
    """Number c of each of the three tubes."""
    at = (TRIO + c) * LANES + i
    return w[at], w[at + PER_TUBE * LANES], w[at + 2 * PER_TUBE * LANES]


@inlined
def sum_tubes(w: Array, i: int, responses: Any, to: int) -> None:
    """Sum the moments of wall forces, tangent and side stiffnesses over all tubes of lane i, to offset `to`.

    These are the three tubes at TRIO, with their responses, and the sums at OTHER_TRIOS.
    """
    f, t, k, e = responses
    x, y, far = _of_tubes(w, i, 0), _of_tubes(w, i, 1), _of_tubes(w, i, 7)
    xx, xy, yy = _of_tubes(w, i, 4), _of_tubes(w, i, 5), _of_tubes(w, i, 6)
    less, g = (-x[0], -x[1], -x[2]), (e[0] * far[0], e[1] * far[1], e[2] * far[2])
    s0, s1, s2, s3 = (
        triple(w, OTHER_TRIOS, i),
        triple(w, OTHER_TRIOS + 3, i),
        triple(w, OTHER_TRIOS + 6, i),
        triple(w, OTHER_TRIOS + 9, i),
    )
    s4, s5, s6 = triple(w, OTHER_TRIOS + 12, i), triple(w, OTHER_TRIOS + 15, i), triple(w, OTHER_TRIOS + 18, i)
    put(w, to, i, (s0[0] + f[0] + f[1] + f[2], _add_products(s0[1], f, y), _add_products(s0[2], f, less)))
    put(w, to + 3, i, (s1[0] + t[0] + t[1] + t[2], _add_products(s1[1], t, x), _add_products(s1[2], t, y)))
    put(w, to + 6, i, (_add_products(s2[0], t, xx), _add_products(s2[1], t, xy), _add_products(s2[2], t, yy)))
    put(w, to + 9, i, (s3[0] + k[0] + k[1] + k[2], _add_products(s3[1], k, x), _add_products(s3[2], k, y)))
    put(w, to + 12, i, (_add_products(s4[0], k, far), s4[1] + e[0] + e[1] + e[2], _add_products(s4[2], e, x)))
    put(w, to + 15, i, (_add_products(s5[0], e, y), _add_products(s5[1], e, xx), _add_products(s5[2], e, xy)))
    put(w, to + 18, i, (_add_products(s6[0], e, yy), _add_products(s6[1], g, x), _add_products(s6[2], g, y)))


@leaf
def sum_other_trios(w: Array, walls: Walls) -> None:
    """Sum the responses of all trios but the last, all lanes, at STRAINS, and copy the last one to TRIO."""
    for i in range(SUMS * LANES):
        w[OTHER_TRIOS * LANES + i] = 0.0
    last = (walls.tubes - 1) // 3
    for k in range(last + 1):
        # The compiler vectorises constant offsets only.
        at = (ALL_TRIOS + PER_TRIO * k) * LANES
        for i in range(PER_TRIO * LANES):
            w[TRIO * LANES + i] = w[at + i]
        if k < last:
            for i in range(LANES):
                v3, u1, u2 = triple(w, STRAINS, i)
                sum_tubes(w, i, tube_responses(w, walls, i, v3, u1, u2), OTHER_TRIOS)


@inlined
def pointwise_wrench(w: Array, i: int, c0: float, v: Triple, u: Triple, v_p: Triple, u_p: Triple):  # type: ignore[no-untyped-def]
    """Total wrench from the sums over the tubes; the blocks hold the damping time times the stiffness."""
    v_t, u_t = plus(v_p, c0, v), plus(u_p, c0, u)
    a = times(six(w, AXIAL, i), (v_t[2], u_t[0], u_t[1]))
    b = times(six(w, SHEAR, i), (v_t[0], v_t[1], u_t[2]))
    offset, force = six(w, OFFSET, i), triple(w, WALL_FORCES, i)
    gamma, spread = w[TUBE * LANES + i], w[(TUBE + 1) * LANES + i]
    k0, kx, ky = triple(w, SECANTS, i)
    kr = w[(SECANTS + 3) * LANES + i]
    return (
        offset[0] + b[0] + gamma * (k0 * v[0] - ky * u[2]),
        offset[1] + b[1] + gamma * (k0 * v[1] + kx * u[2]),
        offset[2] + a[0] + force[0],
    ), (
        offset[3] + a[1] + force[1] + spread * k0 * u[0],
        offset[4] + a[2] + force[2] + spread * k0 * u[1],
        offset[5] + b[2] + gamma * (kx * v[1] - ky * v[0] + kr * u[2]),
    )


@inlined
def pointwise_slopes(w: Array, i: int, c0: float, v: Triple, u: Triple, n: Triple, m: Triple, v_p: Triple, u_p: Triple):  # type: ignore[no-untyped-def]
    """Strain derivatives for the wrench derivatives n, m, by the tangent; v_p, u_p: of the past strains."""
    a11, a12, a13, a22, a23, a33 = six(w, AXIAL, i)
    s11, s12, s13, s22, s23, s33 = six(w, SHEAR, i)
    # Viscous part first.
    f3, f4, f5 = plus((n[2], m[0], m[1]), -1.0, times((a11, a12, a13, a22, a23, a33), (v_p[2], u_p[0], u_p[1])))
    f1, f2, f6 = plus((n[0], n[1], m[2]), -1.0, times((s11, s12, s13, s22, s23, s33), (v_p[0], v_p[1], u_p[2])))
    v1, v2 = v[0], v[1]
    u1, u2, u3 = u
    gamma, spread = w[TUBE * LANES + i], w[(TUBE + 1) * LANES + i]
    t0, tx, ty = triple(w, TANGENTS, i)
    txx, txy, tyy = triple(w, TANGENTS + 3, i)
    t11, t12, t13 = c0 * a11 + t0, c0 * a12 + ty, c0 * a13 - tx
    t22, t23, t33 = c0 * a22 + tyy, c0 * a23 - txy, c0 * a33 + txx
    k0, kx, ky = triple(w, SECANTS, i)
    kr = w[(SECANTS + 3) * LANES + i]
    e0, ex, ey = triple(w, STIFFNESS_SLOPES, i)
    exx, exy, eyy = triple(w, STIFFNESS_SLOPES + 3, i)
    b1, b2 = spread * u1, spread * u2
    # Not symmetric: a tube's own bending stiffness follows its axial strain, not the other way round.
    p21, p22, p23 = t12 + b1 * e0, t22 + b1 * ey + spread * k0, t23 - b1 * ex
    p31, p32, p33 = t13 + b2 * e0, t23 + b2 * ey, t33 - b2 * ex + spread * k0
    m11, m12, m13 = p22 * p33 - p23 * p32, p23 * p31 - p21 * p33, p21 * p32 - p22 * p31
    s11, s12, s13 = c0 * s11 + gamma * k0, c0 * s12, c0 * s13 - gamma * ky
    s22, s23, s33 = c0 * s22 + gamma * k0, c0 * s23 + gamma * kx, c0 * s33 + gamma * kr
    g11, g12, g13 = s22 * s33 - s23 * s23, s13 * s23 - s12 * s33, s12 * s23 - s13 * s22
    first, second = t11 * m11 + t12 * m12 + t13 * m13, s11 * g11 + s12 * g12 + s13 * g13
    both = 1.0 / (first * second)
    over = both * second
    dv3 = over * (m11 * f3 + (t13 * p32 - t12 * p33) * f4 + (t12 * p23 - t13 * p22) * f5)
    du1 = over * (m12 * f3 + (t11 * p33 - t13 * p31) * f4 + (t13 * p21 - t11 * p23) * f5)
    du2 = over * (m13 * f3 + (t12 * p31 - t11 * p32) * f4 + (t11 * p22 - t12 * p21) * f5)
    r0 = e0 * dv3 + ey * du1 - ex * du2
    rx = ex * dv3 + exy * du1 - exx * du2
    ry = ey * dv3 + eyy * du1 - exy * du2
    rr = (
        (exx + eyy + 2.0 * spread * e0) * dv3
        + w[(STIFFNESS_SLOPES + 7) * LANES + i] * du1
        - w[(STIFFNESS_SLOPES + 6) * LANES + i] * du2
    )
    f1 -= gamma * (r0 * v1 - ry * u3)
    f2 -= gamma * (r0 * v2 + rx * u3)
    f6 -= gamma * (rx * v2 - ry * v1 + rr * u3)
    over = both * first
    g22, g23, g33 = s11 * s33 - s13 * s13, s12 * s13 - s11 * s23, s11 * s22 - s12 * s12
    return (
        over * (g11 * f1 + g12 * f2 + g13 * f6), over * (g12 * f1 + g22 * f2 + g23 * f6), dv3,
    ), (du1, du2, over * (g13 * f1 + g23 * f2 + g33 * f6))  # fmt: skip
