"""Right-hand side of the rod (eqs 7-13) and its integration along the arc length.

Everything is written in the section's own frame, with the total wrench: what the walls carry minus what the pressure
pushes. Its balance has no pressure term left,

    n' = -u x n + rho A (q_t + w x q) - f,      m' = -u x m - v x n + rho (J w_t + w x J w) - l,

which is eqs 12 and 13 with the pressure moved into the section law. Time derivatives are y_t = c0 y + y^h (eq 26).
"""

from __future__ import annotations

import math
from typing import Any

from model.compiled import kernel
from model.layout import (
    ACTUATORS,
    AXIAL,
    AXIAL_INVERSE,
    C0,
    CHANGES,
    CURRENT,
    DAMPING,
    INERTIA,
    LANES,
    LINE_DENSITY,
    LINEAR,
    LOAD,
    NODE,
    OFFSET,
    PER_ACTUATOR,
    RATE,
    SECANTS,
    SHEAR,
    SHEAR_INVERSE,
    SLOPE,
    STAGE,
    STATE,
    SUM,
    TANGENTS,
    TUBE,
    WRENCH,
)

Array = Any

# Eq 32 continued oddly has a kink in its secant stiffness at zero force, which no rubber has and Newton's method trips
# over. The wall force keeps the law as it is; shear, own bending and torsion take the secant rounded over this strain.
ROUNDING = 5e-3


@kernel
def linear_wrench(w: Array, hv1: float, hv2: float, hv3: float, hu1: float, hu2: float, hu3: float) -> None:
    """Total wrench of the stage's strains: a constant stiffness, coupled by the actuators' places (eqs 15, 16, 20)."""
    y = STAGE * LANES
    for i in range(LANES):
        tau = w[DAMPING * LANES + i]
        grown = 1.0 + tau * w[C0 * LANES + i]
        v1 = grown * w[y + i] + tau * hv1
        v2 = grown * w[y + LANES + i] + tau * hv2
        v3 = grown * w[y + 2 * LANES + i] + tau * hv3
        u1 = grown * w[y + 3 * LANES + i] + tau * hu1
        u2 = grown * w[y + 4 * LANES + i] + tau * hu2
        u3 = grown * w[y + 5 * LANES + i] + tau * hu3
        a12, a13, a23 = w[(AXIAL + 1) * LANES + i], w[(AXIAL + 2) * LANES + i], w[(AXIAL + 4) * LANES + i]
        s12, s13, s23 = w[(SHEAR + 1) * LANES + i], w[(SHEAR + 2) * LANES + i], w[(SHEAR + 4) * LANES + i]
        w[WRENCH * LANES + i] = w[OFFSET * LANES + i] + w[SHEAR * LANES + i] * v1 + s12 * v2 + s13 * u3
        w[(WRENCH + 1) * LANES + i] = (
            w[(OFFSET + 1) * LANES + i] + s12 * v1 + w[(SHEAR + 3) * LANES + i] * v2 + s23 * u3
        )
        w[(WRENCH + 2) * LANES + i] = w[(OFFSET + 2) * LANES + i] + w[AXIAL * LANES + i] * v3 + a12 * u1 + a13 * u2
        w[(WRENCH + 3) * LANES + i] = (
            w[(OFFSET + 3) * LANES + i] + a12 * v3 + w[(AXIAL + 3) * LANES + i] * u1 + a23 * u2
        )
        w[(WRENCH + 4) * LANES + i] = (
            w[(OFFSET + 4) * LANES + i] + a13 * v3 + a23 * u1 + w[(AXIAL + 5) * LANES + i] * u2
        )
        w[(WRENCH + 5) * LANES + i] = (
            w[(OFFSET + 5) * LANES + i] + s13 * v1 + s23 * v2 + w[(SHEAR + 5) * LANES + i] * u3
        )


@kernel
def linear_slopes(w: Array, gv1: float, gv2: float, gv3: float, gu1: float, gu2: float, gu3: float) -> None:
    """Strain slopes whose wrench changes at the stage's rate; g is the slope of the strains' history."""
    for i in range(LANES):
        tau = w[DAMPING * LANES + i]
        shrunk = 1.0 / (1.0 + tau * w[C0 * LANES + i])
        tau = tau * shrunk
        n1, n2, n3 = w[RATE * LANES + i], w[(RATE + 1) * LANES + i], w[(RATE + 2) * LANES + i]
        m1, m2, m3 = w[(RATE + 3) * LANES + i], w[(RATE + 4) * LANES + i], w[(RATE + 5) * LANES + i]
        b, c = AXIAL_INVERSE, SHEAR_INVERSE
        a12, a13, a23 = w[(b + 1) * LANES + i], w[(b + 2) * LANES + i], w[(b + 4) * LANES + i]
        s12, s13, s23 = w[(c + 1) * LANES + i], w[(c + 2) * LANES + i], w[(c + 4) * LANES + i]
        v1 = w[c * LANES + i] * n1 + s12 * n2 + s13 * m3
        v2 = s12 * n1 + w[(c + 3) * LANES + i] * n2 + s23 * m3
        u3 = s13 * n1 + s23 * n2 + w[(c + 5) * LANES + i] * m3
        v3 = w[b * LANES + i] * n3 + a12 * m1 + a13 * m2
        u1 = a12 * n3 + w[(b + 3) * LANES + i] * m1 + a23 * m2
        u2 = a13 * n3 + a23 * m1 + w[(b + 5) * LANES + i] * m2
        w[SLOPE * LANES + i] = shrunk * v1 - tau * gv1
        w[(SLOPE + 1) * LANES + i] = shrunk * v2 - tau * gv2
        w[(SLOPE + 2) * LANES + i] = shrunk * v3 - tau * gv3
        w[(SLOPE + 3) * LANES + i] = shrunk * u1 - tau * gu1
        w[(SLOPE + 4) * LANES + i] = shrunk * u2 - tau * gu2
        w[(SLOPE + 5) * LANES + i] = shrunk * u3 - tau * gu3


@kernel
def pointwise_wrench(
    w: Array, actuators: int, hv1: float, hv2: float, hv3: float, hu1: float, hu2: float, hu3: float
) -> None:
    """Total wrench of the stage's strains where each tube follows eq 32 at its own place (section.py derives it).

    Leaves in the work array what `pointwise_slopes` needs: sums over the tubes of their stiffnesses.
    """
    y = STAGE * LANES
    linear_wrench(w, hv1, hv2, hv3, hu1, hu2, hu3)
    # The stiffness blocks hold the small-strain values, which only damp here: take their elastic part out again.
    for i in range(LANES):
        v1, v2, v3 = w[y + i], w[y + LANES + i], w[y + 2 * LANES + i]
        u1, u2, u3 = w[y + 3 * LANES + i], w[y + 4 * LANES + i], w[y + 5 * LANES + i]
        a12, a13, a23 = w[(AXIAL + 1) * LANES + i], w[(AXIAL + 2) * LANES + i], w[(AXIAL + 4) * LANES + i]
        s12, s13, s23 = w[(SHEAR + 1) * LANES + i], w[(SHEAR + 2) * LANES + i], w[(SHEAR + 4) * LANES + i]
        w[WRENCH * LANES + i] -= w[SHEAR * LANES + i] * v1 + s12 * v2 + s13 * u3
        w[(WRENCH + 1) * LANES + i] -= s12 * v1 + w[(SHEAR + 3) * LANES + i] * v2 + s23 * u3
        w[(WRENCH + 2) * LANES + i] -= w[AXIAL * LANES + i] * v3 + a12 * u1 + a13 * u2
        w[(WRENCH + 3) * LANES + i] -= a12 * v3 + w[(AXIAL + 3) * LANES + i] * u1 + a23 * u2
        w[(WRENCH + 4) * LANES + i] -= a13 * v3 + a23 * u1 + w[(AXIAL + 5) * LANES + i] * u2
        w[(WRENCH + 5) * LANES + i] -= s13 * v1 + s23 * v2 + w[(SHEAR + 5) * LANES + i] * u3
    for i in range(18 * LANES):
        w[TANGENTS * LANES + i] = 0.0
    for k in range(actuators):
        # Copied to a constant place, or the compiler gives up on vector instructions.
        at = (ACTUATORS + PER_ACTUATOR * k) * LANES
        for i in range(PER_ACTUATOR * LANES):
            w[CURRENT * LANES + i] = w[at + i]
        for i in range(LANES):
            x, yy = w[CURRENT * LANES + i], w[(CURRENT + 1) * LANES + i]
            a1, a2, spread = w[TUBE * LANES + i], w[(TUBE + 1) * LANES + i], w[(TUBE + 3) * LANES + i]
            strain = w[y + 2 * LANES + i] - 1.0 + yy * w[y + 3 * LANES + i] - x * w[y + 4 * LANES + i]
            strain -= w[(CURRENT + 2) * LANES + i]
            root = math.sqrt(a1 * a1 + 4.0 * a2 * abs(strain))
            force = 2.0 * strain / (a1 + root)
            tangent = 1.0 / root
            rounded = math.sqrt(strain * strain + ROUNDING * ROUNDING)
            root = math.sqrt(a1 * a1 + 4.0 * a2 * rounded)
            stiffness = 2.0 / (a1 + root)
            change = -stiffness * stiffness * a2 * strain / (root * rounded)
            square = x * x + yy * yy + 2.0 * spread
            w[(WRENCH + 2) * LANES + i] += force
            w[(WRENCH + 3) * LANES + i] += yy * force
            w[(WRENCH + 4) * LANES + i] -= x * force
            w[TANGENTS * LANES + i] += tangent
            w[(TANGENTS + 1) * LANES + i] += tangent * x
            w[(TANGENTS + 2) * LANES + i] += tangent * yy
            w[(TANGENTS + 3) * LANES + i] += tangent * x * x
            w[(TANGENTS + 4) * LANES + i] += tangent * x * yy
            w[(TANGENTS + 5) * LANES + i] += tangent * yy * yy
            w[SECANTS * LANES + i] += stiffness
            w[(SECANTS + 1) * LANES + i] += stiffness * x
            w[(SECANTS + 2) * LANES + i] += stiffness * yy
            w[(SECANTS + 3) * LANES + i] += stiffness * square
            w[CHANGES * LANES + i] += change
            w[(CHANGES + 1) * LANES + i] += change * x
            w[(CHANGES + 2) * LANES + i] += change * yy
            w[(CHANGES + 3) * LANES + i] += change * x * x
            w[(CHANGES + 4) * LANES + i] += change * x * yy
            w[(CHANGES + 5) * LANES + i] += change * yy * yy
            w[(CHANGES + 6) * LANES + i] += change * square * x
            w[(CHANGES + 7) * LANES + i] += change * square * yy
    for i in range(LANES):
        v1, v2 = w[y + i], w[y + LANES + i]
        u1, u2, u3 = w[y + 3 * LANES + i], w[y + 4 * LANES + i], w[y + 5 * LANES + i]
        gamma, spread = w[(TUBE + 2) * LANES + i], w[(TUBE + 3) * LANES + i]
        k0, kx = w[SECANTS * LANES + i], w[(SECANTS + 1) * LANES + i]
        ky, kr = w[(SECANTS + 2) * LANES + i], w[(SECANTS + 3) * LANES + i]
        w[WRENCH * LANES + i] += gamma * (k0 * v1 - ky * u3)
        w[(WRENCH + 1) * LANES + i] += gamma * (k0 * v2 + kx * u3)
        w[(WRENCH + 3) * LANES + i] += spread * k0 * u1
        w[(WRENCH + 4) * LANES + i] += spread * k0 * u2
        w[(WRENCH + 5) * LANES + i] += gamma * (kx * v2 - ky * v1 + kr * u3)


@kernel
def pointwise_slopes(w: Array, gv1: float, gv2: float, gv3: float, gu1: float, gu2: float, gu3: float) -> None:
    """Strain slopes whose wrench changes at the stage's rate, by the tangent of the pointwise law."""
    y = STAGE * LANES
    for i in range(LANES):
        # Viscous part first: its stiffness is c0 tau times the small-strain one.
        tau = w[DAMPING * LANES + i]
        d = tau * w[C0 * LANES + i]
        a11, a12, a13 = w[AXIAL * LANES + i], w[(AXIAL + 1) * LANES + i], w[(AXIAL + 2) * LANES + i]
        a22, a23, a33 = w[(AXIAL + 3) * LANES + i], w[(AXIAL + 4) * LANES + i], w[(AXIAL + 5) * LANES + i]
        s11, s12, s13 = w[SHEAR * LANES + i], w[(SHEAR + 1) * LANES + i], w[(SHEAR + 2) * LANES + i]
        s22, s23, s33 = w[(SHEAR + 3) * LANES + i], w[(SHEAR + 4) * LANES + i], w[(SHEAR + 5) * LANES + i]
        f3 = w[(RATE + 2) * LANES + i] - tau * (a11 * gv3 + a12 * gu1 + a13 * gu2)
        f4 = w[(RATE + 3) * LANES + i] - tau * (a12 * gv3 + a22 * gu1 + a23 * gu2)
        f5 = w[(RATE + 4) * LANES + i] - tau * (a13 * gv3 + a23 * gu1 + a33 * gu2)
        f1 = w[RATE * LANES + i] - tau * (s11 * gv1 + s12 * gv2 + s13 * gu3)
        f2 = w[(RATE + 1) * LANES + i] - tau * (s12 * gv1 + s22 * gv2 + s23 * gu3)
        f6 = w[(RATE + 5) * LANES + i] - tau * (s13 * gv1 + s23 * gv2 + s33 * gu3)
        v1, v2 = w[y + i], w[y + LANES + i]
        u1, u2, u3 = w[y + 3 * LANES + i], w[y + 4 * LANES + i], w[y + 5 * LANES + i]
        gamma, spread = w[(TUBE + 2) * LANES + i], w[(TUBE + 3) * LANES + i]
        t11 = d * a11 + w[TANGENTS * LANES + i]
        t12 = d * a12 + w[(TANGENTS + 2) * LANES + i]
        t13 = d * a13 - w[(TANGENTS + 1) * LANES + i]
        t22 = d * a22 + w[(TANGENTS + 5) * LANES + i]
        t23 = d * a23 - w[(TANGENTS + 4) * LANES + i]
        t33 = d * a33 + w[(TANGENTS + 3) * LANES + i]
        k0, kx = w[SECANTS * LANES + i], w[(SECANTS + 1) * LANES + i]
        ky, kr = w[(SECANTS + 2) * LANES + i], w[(SECANTS + 3) * LANES + i]
        e0, ex, ey = w[CHANGES * LANES + i], w[(CHANGES + 1) * LANES + i], w[(CHANGES + 2) * LANES + i]
        exx, exy = w[(CHANGES + 3) * LANES + i], w[(CHANGES + 4) * LANES + i]
        eyy = w[(CHANGES + 5) * LANES + i]
        b1, b2 = spread * u1, spread * u2
        # Not symmetric: a tube's own bending stiffness follows its axial strain, not the other way round.
        p21, p22, p23 = t12 + b1 * e0, t22 + b1 * ey + spread * k0, t23 - b1 * ex
        p31, p32, p33 = t13 + b2 * e0, t23 + b2 * ey, t33 - b2 * ex + spread * k0
        m11, m12, m13 = p22 * p33 - p23 * p32, p23 * p31 - p21 * p33, p21 * p32 - p22 * p31
        over = 1.0 / (t11 * m11 + t12 * m12 + t13 * m13)
        dv3 = over * (m11 * f3 + (t13 * p32 - t12 * p33) * f4 + (t12 * p23 - t13 * p22) * f5)
        du1 = over * (m12 * f3 + (t11 * p33 - t13 * p31) * f4 + (t13 * p21 - t11 * p23) * f5)
        du2 = over * (m13 * f3 + (t12 * p31 - t11 * p32) * f4 + (t11 * p22 - t12 * p21) * f5)
        err = exx + eyy + 2.0 * spread * e0
        r0 = e0 * dv3 + ey * du1 - ex * du2
        rx = ex * dv3 + exy * du1 - exx * du2
        ry = ey * dv3 + eyy * du1 - exy * du2
        rr = err * dv3 + w[(CHANGES + 7) * LANES + i] * du1 - w[(CHANGES + 6) * LANES + i] * du2
        f1 -= gamma * (r0 * v1 - ry * u3)
        f2 -= gamma * (r0 * v2 + rx * u3)
        f6 -= gamma * (rx * v2 - ry * v1 + rr * u3)
        s11, s12, s13 = d * s11 + gamma * k0, d * s12, d * s13 - gamma * ky
        s22, s23, s33 = d * s22 + gamma * k0, d * s23 + gamma * kx, d * s33 + gamma * kr
        m11, m12, m13 = s22 * s33 - s23 * s23, s13 * s23 - s12 * s33, s12 * s23 - s13 * s22
        over = 1.0 / (s11 * m11 + s12 * m12 + s13 * m13)
        m22, m23, m33 = s11 * s33 - s13 * s13, s12 * s13 - s11 * s23, s11 * s22 - s12 * s12
        w[SLOPE * LANES + i] = over * (m11 * f1 + m12 * f2 + m13 * f6)
        w[(SLOPE + 1) * LANES + i] = over * (m12 * f1 + m22 * f2 + m23 * f6)
        w[(SLOPE + 2) * LANES + i] = dv3
        w[(SLOPE + 3) * LANES + i] = du1
        w[(SLOPE + 4) * LANES + i] = du2
        w[(SLOPE + 5) * LANES + i] = over * (m13 * f1 + m23 * f2 + m33 * f6)


@kernel
def loads_in_section(w: Array, f1: float, f2: float, f3: float, l1: float, l2: float, l3: float) -> None:
    """Turn a distributed load (force and moment per metre, base frame) into the section frame."""
    y = STAGE * LANES
    for i in range(LANES):
        a, b = w[y + 12 * LANES + i], w[y + 13 * LANES + i]
        c, d = w[y + 14 * LANES + i], w[y + 15 * LANES + i]
        s = 2.0 / (a * a + b * b + c * c + d * d)
        r11, r12, r13 = 1.0 - s * (c * c + d * d), s * (b * c - d * a), s * (b * d + c * a)
        r21, r22, r23 = s * (b * c + d * a), 1.0 - s * (b * b + d * d), s * (c * d - b * a)
        r31, r32, r33 = s * (b * d - c * a), s * (c * d + b * a), 1.0 - s * (b * b + c * c)
        w[LOAD * LANES + i] = r11 * f1 + r21 * f2 + r31 * f3
        w[(LOAD + 1) * LANES + i] = r12 * f1 + r22 * f2 + r32 * f3
        w[(LOAD + 2) * LANES + i] = r13 * f1 + r23 * f2 + r33 * f3
        w[(LOAD + 3) * LANES + i] = r11 * l1 + r21 * l2 + r31 * l3
        w[(LOAD + 4) * LANES + i] = r12 * l1 + r22 * l2 + r32 * l3
        w[(LOAD + 5) * LANES + i] = r13 * l1 + r23 * l2 + r33 * l3


@kernel
def balance(
    w: Array,
    hv1: float,
    hv2: float,
    hv3: float,
    hu1: float,
    hu2: float,
    hu3: float,
    hq1: float,
    hq2: float,
    hq3: float,
    hw1: float,
    hw2: float,
    hw3: float,
) -> None:
    """Slopes of velocities (eq 11) and orientation (eq 9), and the rate of the wrench (eqs 12, 13)."""
    y = STAGE * LANES
    for i in range(LANES):
        v1, v2, v3 = w[y + i], w[y + LANES + i], w[y + 2 * LANES + i]
        u1, u2, u3 = w[y + 3 * LANES + i], w[y + 4 * LANES + i], w[y + 5 * LANES + i]
        q1, q2, q3 = w[y + 6 * LANES + i], w[y + 7 * LANES + i], w[y + 8 * LANES + i]
        w1, w2, w3 = w[y + 9 * LANES + i], w[y + 10 * LANES + i], w[y + 11 * LANES + i]
        a, b = w[y + 12 * LANES + i], w[y + 13 * LANES + i]
        c, d = w[y + 14 * LANES + i], w[y + 15 * LANES + i]
        n1, n2, n3 = w[WRENCH * LANES + i], w[(WRENCH + 1) * LANES + i], w[(WRENCH + 2) * LANES + i]
        m1, m2, m3 = w[(WRENCH + 3) * LANES + i], w[(WRENCH + 4) * LANES + i], w[(WRENCH + 5) * LANES + i]
        c0, mass = w[C0 * LANES + i], w[LINE_DENSITY * LANES + i]
        j11, j22 = w[INERTIA * LANES + i], w[(INERTIA + 1) * LANES + i]
        j12, j33 = w[(INERTIA + 2) * LANES + i], w[(INERTIA + 3) * LANES + i]
        w[(SLOPE + 6) * LANES + i] = c0 * v1 + hv1 - u2 * q3 + u3 * q2 + w2 * v3 - w3 * v2
        w[(SLOPE + 7) * LANES + i] = c0 * v2 + hv2 - u3 * q1 + u1 * q3 + w3 * v1 - w1 * v3
        w[(SLOPE + 8) * LANES + i] = c0 * v3 + hv3 - u1 * q2 + u2 * q1 + w1 * v2 - w2 * v1
        w[(SLOPE + 9) * LANES + i] = c0 * u1 + hu1 - u2 * w3 + u3 * w2
        w[(SLOPE + 10) * LANES + i] = c0 * u2 + hu2 - u3 * w1 + u1 * w3
        w[(SLOPE + 11) * LANES + i] = c0 * u3 + hu3 - u1 * w2 + u2 * w1
        w[(SLOPE + 12) * LANES + i] = -0.5 * (b * u1 + c * u2 + d * u3)
        w[(SLOPE + 13) * LANES + i] = 0.5 * (a * u1 + c * u3 - d * u2)
        w[(SLOPE + 14) * LANES + i] = 0.5 * (a * u2 + d * u1 - b * u3)
        w[(SLOPE + 15) * LANES + i] = 0.5 * (a * u3 + b * u2 - c * u1)
        w[RATE * LANES + i] = u3 * n2 - u2 * n3 + mass * (c0 * q1 + hq1 + w2 * q3 - w3 * q2) - w[LOAD * LANES + i]
        w[(RATE + 1) * LANES + i] = (
            u1 * n3 - u3 * n1 + mass * (c0 * q2 + hq2 + w3 * q1 - w1 * q3) - w[(LOAD + 1) * LANES + i]
        )
        w[(RATE + 2) * LANES + i] = (
            u2 * n1 - u1 * n2 + mass * (c0 * q3 + hq3 + w1 * q2 - w2 * q1) - w[(LOAD + 2) * LANES + i]
        )
        p1, p2, p3 = j11 * w1 + j12 * w2, j12 * w1 + j22 * w2, j33 * w3
        t1, t2, t3 = c0 * w1 + hw1, c0 * w2 + hw2, c0 * w3 + hw3
        w[(RATE + 3) * LANES + i] = (
            u3 * m2 - u2 * m3 + v3 * n2 - v2 * n3 + j11 * t1 + j12 * t2 + w2 * p3 - w3 * p2 - w[(LOAD + 3) * LANES + i]
        )
        w[(RATE + 4) * LANES + i] = (
            u1 * m3 - u3 * m1 + v1 * n3 - v3 * n1 + j12 * t1 + j22 * t2 + w3 * p1 - w1 * p3 - w[(LOAD + 4) * LANES + i]
        )
        w[(RATE + 5) * LANES + i] = (
            u2 * m1 - u1 * m2 + v2 * n1 - v1 * n2 + j33 * t3 + w1 * p2 - w2 * p1 - w[(LOAD + 5) * LANES + i]
        )


@kernel
def stage_wrench(w: Array, law: int, actuators: int, history: Array, row: int) -> None:
    """Total wrench at the stage, by whichever section law is in force."""
    h = history[row]
    if law == LINEAR:
        linear_wrench(w, h[0], h[1], h[2], h[3], h[4], h[5])
    else:
        pointwise_wrench(w, actuators, h[0], h[1], h[2], h[3], h[4], h[5])


@kernel
def slopes(w: Array, law: int, actuators: int, history: Array, load: Array, loaded: bool, row: int) -> None:
    """The right-hand side: slopes along the arc length of the stage's state, all lanes."""
    h = history[row]
    if loaded:
        f = load[row]
        loads_in_section(w, f[0], f[1], f[2], f[3], f[4], f[5])
    stage_wrench(w, law, actuators, history, row)
    balance(w, h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8], h[9], h[10], h[11])
    if law == LINEAR:
        linear_slopes(w, h[12], h[13], h[14], h[15], h[16], h[17])
    else:
        pointwise_slopes(w, h[12], h[13], h[14], h[15], h[16], h[17])


@kernel
def _store(w: Array, states: Array, derivatives: Array, j: int) -> None:
    for i in range(STATE * LANES):
        states[j, i] = w[NODE * LANES + i]
        derivatives[j, i] = w[SLOPE * LANES + i]


@kernel
def integrate(
    w: Array,
    law: int,
    actuators: int,
    history: Array,
    load: Array,
    loaded: bool,
    first: int,
    last: int,
    h: float,
    states: Array,
    derivatives: Array,
) -> None:
    """Integrate the node's state, all lanes, from node `first` to node `last` in steps of h [m] by RK4.

    history, load: one row per node and per mid-point, (2 N + 1, ..). states, derivatives: (N + 1, 128), filled at each
    node; at `last`, only the state is left, in the work array.
    """
    size = STATE * LANES
    for j in range(first, last):
        for i in range(size):
            w[STAGE * LANES + i] = w[NODE * LANES + i]
        slopes(w, law, actuators, history, load, loaded, 2 * j)
        _store(w, states, derivatives, j)
        for i in range(size):
            w[SUM * LANES + i] = w[SLOPE * LANES + i]
            w[STAGE * LANES + i] = w[NODE * LANES + i] + 0.5 * h * w[SLOPE * LANES + i]
        slopes(w, law, actuators, history, load, loaded, 2 * j + 1)
        for i in range(size):
            w[SUM * LANES + i] += 2.0 * w[SLOPE * LANES + i]
            w[STAGE * LANES + i] = w[NODE * LANES + i] + 0.5 * h * w[SLOPE * LANES + i]
        slopes(w, law, actuators, history, load, loaded, 2 * j + 1)
        for i in range(size):
            w[SUM * LANES + i] += 2.0 * w[SLOPE * LANES + i]
            w[STAGE * LANES + i] = w[NODE * LANES + i] + h * w[SLOPE * LANES + i]
        slopes(w, law, actuators, history, load, loaded, 2 * j + 2)
        for i in range(size):
            w[NODE * LANES + i] += h / 6.0 * (w[SUM * LANES + i] + w[SLOPE * LANES + i])
