"""Kernels that decide whether an arm at rest is stable: the sign of the potential energy's second variation.

With xi the displacement and theta the rotation of a section, both in its own frame, and n, m the total wrench,

    gamma = xi' + u x xi + v x theta,      kappa = theta' + u x theta,
    d2E = int (gamma, kappa) K (gamma, kappa) - 2 gamma . (n x theta) - kappa . (m x theta)
              + (n . v) |theta|^2 - (n . theta) (v . theta) ds  +  terms of the load at the tip.

docs/explanation/model.md derives it. K is the symmetric part of the tangent stiffness of the section. Two tests follow:
a sufficient inequality, which is cheap and holds for the ordinary arm, and the exact count of negative directions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from model.kernels.arguments import ArmArguments, Fields, Rod, rod_of
from model.kernels.jit import kernel
from model.kernels.law import Walls
from model.kernels.layout import AXIAL, LANES, SECANTS, SHEAR, STAGE, STIFFNESS_SLOPES, TANGENTS, TUBE, WRENCH
from model.kernels.rod import pointwise, resting_wrench
from model.kernels.vec3 import Triple, dot, inlined, leaf, rotation, three, triple

Array = Any

NODE_UNKNOWNS = 6
STRAIN_UNKNOWNS = 9  # gamma, kappa and theta
ELEMENT = 18  # unknowns of an element: first node, mid-point, last node
GAUSS = 1.0 / math.sqrt(3.0)
# Factor on the wrenches at the nodes, so that the inequality also holds between them.
MARGIN = 1.1
# Share of the axial stiffness kept for stretch in the inequality; the rest bounds its coupling with bending.
STRETCH_SHARE = 0.125
# Threshold of a negative direction, relative to the softest bending stiffness, for rounding and discretisation errors.
NEUTRAL = 1e-7


@inlined
def _tangent_blocks(w: Array, i: int):  # type: ignore[no-untyped-def]
    """Of lane i, after `resting_wrench`: axial block 11, 12, 13, 22, 23, 33, and shear block 11, 13, 23, 33.

    The symmetric parts of the tangent.
    """
    if not pointwise(w):
        a, s = AXIAL * LANES + i, SHEAR * LANES + i
        return (
            w[a], w[a + LANES], w[a + 2 * LANES], w[a + 3 * LANES], w[a + 4 * LANES], w[a + 5 * LANES],
            w[s], w[s + 2 * LANES], w[s + 4 * LANES], w[s + 5 * LANES],
        )  # fmt: skip
    gamma, spread = w[TUBE * LANES + i], w[(TUBE + 1) * LANES + i]
    t0, tx, ty = triple(w, TANGENTS, i)
    txx, txy, tyy = triple(w, TANGENTS + 3, i)
    k0, kx, ky = triple(w, SECANTS, i)
    return (
        t0, ty, -tx, tyy + spread * k0, -txy, txx + spread * k0,
        gamma * k0, -gamma * ky, gamma * kx, gamma * w[(SECANTS + 3) * LANES + i],
    )  # fmt: skip


@inlined
def _stiffness_bound(w: Array, i: int):  # type: ignore[no-untyped-def]
    """Numbers a, b with (gamma, kappa) K (gamma, kappa) >= a |gamma|^2 + b |kappa|^2 minus `_asymmetric_bound`."""
    a11, a12, a13, a22, a23, a33, s11, s13, s23, s33 = _tangent_blocks(w, i)
    over = 1.0 / (1.0 - STRETCH_SHARE)
    apart = math.sqrt((a22 - a33) * (a22 - a33) + 4.0 * a23 * a23)
    bending = 0.5 * (a22 + a33 - apart) - over * (a12 * a12 + a13 * a13) / a11
    torsion = s33 - over * (s13 * s13 + s23 * s23) / s11
    return STRETCH_SHARE * min(a11, s11), min(bending, torsion)


@inlined
def _asymmetric_bound(w: Array, i: int):  # type: ignore[no-untyped-def]
    """Upper bound of the terms by which bending and shear stiffness of a pointwise section depend on the axial strain.

    Factors of |gamma|^2, |gamma| |kappa| and |kappa|^2.
    """
    gamma, spread = w[TUBE * LANES + i], w[(TUBE + 1) * LANES + i]
    v1, v2, _ = triple(w, STAGE, i)
    u1, u2, u3 = triple(w, STAGE + 3, i)
    e0, ex, ey = triple(w, STIFFNESS_SLOPES, i)
    exx, exy, eyy = triple(w, STIFFNESS_SLOPES + 3, i)
    far = abs(w[(STIFFNESS_SLOPES + 6) * LANES + i]) + abs(w[(STIFFNESS_SLOPES + 7) * LANES + i])
    once, twice, turn = abs(ex) + abs(ey), abs(exx) + abs(exy) + abs(eyy), abs(exx + eyy + 2.0 * spread * e0)
    bent, sheared, twisted = spread * (abs(u1) + abs(u2)), gamma * (abs(v1) + abs(v2)), gamma * abs(u3)
    return (
        sheared * abs(e0) + 2.0 * twisted * once,
        bent * abs(e0) + 2.0 * sheared * once + twisted * (2.0 * twice + turn),
        bent * once + sheared * twice + twisted * far,
    )


@leaf
def satisfies_stability_bound(rod: Rod, x: Array) -> bool:
    """Whether a sufficient inequality proves the solved arm x stable. False decides nothing.

    |theta|' <= |kappa| and theta = 0 at the base give int |theta|^2 <= (2 L / pi)^2 int |kappa|^2. With bounds on K and
    on the wrenches, the second variation is then at least a quadratic form of two numbers. It has no terms for
    couplings of any length, or between lines that are apart.
    """
    walls, line = rod.walls, rod.line
    stiff, bending, mixed, ends, deformable = np.inf, np.inf, 0.0, 0.0, 0.0
    force, moment, pressed = 0.0, 0.0, 0.0
    for k in range(line.step.shape[0]):
        w, end, last = rod.work[k], rod.ends[k], line.first[k + 1] - 1
        deformable += line.step[k] * (last - line.first[k])
        if dot(three(line.joint[k], 0), three(line.joint[k], 0)) > 0.0:
            return False
        for first in range(line.first[k], last + 1, LANES):
            for i in range(LANES):
                j = min(first + i, last)
                for c in range(6):
                    w[(STAGE + c) * LANES + i] = x[j, c]
            resting_wrench(w, walls)
            for i in range(LANES):
                v, f, m = triple(w, STAGE, i), triple(w, WRENCH, i), triple(w, WRENCH + 3, i)
                size = math.sqrt(dot(f, f))
                force, moment = max(force, size), max(moment, dot(m, m))
                pressed = max(pressed, 0.5 * (size * math.sqrt(dot(v, v)) - dot(f, v)))
                if pointwise(w):
                    a, b = _stiffness_bound(w, i)
                    less, between, least = _asymmetric_bound(w, i)
                    stiff, bending, mixed = min(stiff, a - less), min(bending, b - least), max(mixed, between)
        if not pointwise(w):
            a, b = _stiffness_bound(w, 0)
            stiff, bending = min(stiff, a), min(bending, b)
        place, lever, pull = three(end, 10), three(end, 16), three(end, 13)
        ends += math.sqrt(dot(three(end, 0), three(end, 0)) * dot(place, place)) + math.sqrt(
            dot(lever, lever) * dot(pull, pull)
        )
    reach = 2.0 * deformable / math.pi
    bending -= MARGIN * (reach * (math.sqrt(moment) + reach * pressed) + deformable * ends)
    between = MARGIN * force * reach + 0.5 * mixed
    return bool(stiff > 0.0 and bending > 0.0 and stiff * bending > between * between)


@leaf
def _fill_tangent(w: Array, i: int, h: Array) -> None:
    """Fill h (9, 9) with the symmetric part of the tangent of lane i over (gamma, kappa)."""
    for r in range(6):
        for c in range(6):
            h[r, c] = 0.0
    a11, a12, a13, a22, a23, a33, s11, s13, s23, s33 = _tangent_blocks(w, i)
    h[0, 0], h[1, 1], h[5, 5] = s11, s11, s33
    h[0, 5], h[1, 5] = s13, s23
    if not pointwise(w):
        h[0, 1], h[1, 1] = w[(SHEAR + 1) * LANES + i], w[(SHEAR + 3) * LANES + i]
    h[2, 2], h[2, 3], h[2, 4], h[3, 3], h[3, 4], h[4, 4] = a11, a12, a13, a22, a23, a33
    if pointwise(w):
        gamma, spread = w[TUBE * LANES + i], w[(TUBE + 1) * LANES + i]
        v1, v2, _ = triple(w, STAGE, i)
        u1, u2, u3 = triple(w, STAGE + 3, i)
        e0, ex, ey = triple(w, STIFFNESS_SLOPES, i)
        exx, exy, eyy = triple(w, STIFFNESS_SLOPES + 3, i)
        rrx, rry = w[(STIFFNESS_SLOPES + 6) * LANES + i], w[(STIFFNESS_SLOPES + 7) * LANES + i]
        sums, by_x, by_y = (e0, ey, -ex), (ex, exy, -exx), (ey, eyy, -exy)
        turns = (exx + eyy + 2.0 * spread * e0, rry, -rrx)
        for k in range(3):
            # Half of the terms on one side of the diagonal only.
            c = 2 + k
            h[0, c] += 0.5 * gamma * (sums[k] * v1 - by_y[k] * u3)
            h[1, c] += 0.5 * gamma * (sums[k] * v2 + by_x[k] * u3)
            h[c, 5] += 0.5 * gamma * (by_x[k] * v2 - by_y[k] * v1 + turns[k] * u3)
            h[min(3, c), max(3, c)] += (1.0 if c == 3 else 0.5) * spread * u1 * sums[k]
            h[min(4, c), max(4, c)] += (1.0 if c == 4 else 0.5) * spread * u2 * sums[k]
    for r in range(6):
        for c in range(r):
            h[r, c] = h[c, r]


@leaf
def _fill_cross_product(h: Array, row: int, share: float, a: tuple[float, float, float]) -> None:
    """Fill the blocks beside the diagonal with -share times the matrix of a x theta."""
    for r in range(3):
        h[row + r, 6 + r] = 0.0
    h[row, 7], h[row, 8] = share * a[2], -share * a[1]
    h[row + 1, 6], h[row + 1, 8] = -share * a[2], share * a[0]
    h[row + 2, 6], h[row + 2, 7] = share * a[1], -share * a[0]
    for r in range(3):
        for c in range(3):
            h[6 + c, row + r] = h[row + r, 6 + c]


@inlined
def _add_load_stiffness(a: tuple[float, float, float], b: tuple[float, float, float], d: Array, at: int) -> None:
    """Add (a . b) |theta|^2 - (a . theta) (b . theta) to a matrix from row and column `at` on."""
    for r in range(3):
        d[at + r, at + r] += dot(a, b)
        for c in range(3):
            d[at + r, at + c] -= 0.5 * (a[r] * b[c] + a[c] * b[r])


@leaf
def _fill_integrand(w: Array, i: int, h: Array) -> None:
    """Fill h (9, 9) with the integrand of the second variation at lane i over (gamma, kappa, theta)."""
    _fill_tangent(w, i, h)
    v, n, m = triple(w, STAGE, i), triple(w, WRENCH, i), triple(w, WRENCH + 3, i)
    _fill_cross_product(h, 0, 1.0, n)
    _fill_cross_product(h, 3, 0.5, m)
    for r in range(3):
        for c in range(3):
            h[6 + r, 6 + c] = 0.0
    _add_load_stiffness(n, v, h, 6)


@leaf
def _add_gauss_point(w: Array, i: int, at: float, step: float, h: Array, b: Array, hb: Array, k: Array) -> None:
    """Add the Gauss point of lane i, `at` in [-1, 1] of an element of length `step`, to its matrix k (18, 18)."""
    v, u = triple(w, STAGE, i), triple(w, STAGE + 3, i)
    share, over = 0.5 * step, 2.0 / step
    for node in range(3):
        value = 1.0 - at * at if node == 1 else 0.5 * at * (at + (node - 1.0))
        slope = over * (-2.0 * at if node == 1 else at + 0.5 * (node - 1.0))
        for r in range(STRAIN_UNKNOWNS):
            for c in range(NODE_UNKNOWNS):
                b[node, r, c] = 0.0
        for r in range(3):
            one, two = (r + 1) % 3, (r + 2) % 3
            for column in (0, 3):
                b[node, column + r, column + r] = slope
                b[node, column + r, column + one] = -value * u[two]
                b[node, column + r, column + two] = value * u[one]
            b[node, r, 3 + one] = -value * v[two]
            b[node, r, 3 + two] = value * v[one]
            b[node, 6 + r, 3 + r] = value
    for right in range(3):
        for r in range(STRAIN_UNKNOWNS):
            for c in range(NODE_UNKNOWNS):
                total = 0.0
                for q in range(STRAIN_UNKNOWNS):
                    total += h[r, q] * b[right, q, c]
                hb[r, c] = share * total
        for left in range(right, 3):
            for q in range(STRAIN_UNKNOWNS):
                for r in range(NODE_UNKNOWNS):
                    value = b[left, q, r]
                    for c in range(NODE_UNKNOWNS):
                        k[NODE_UNKNOWNS * left + r, NODE_UNKNOWNS * right + c] += value * hb[q, c]


@leaf
def _eliminate(k: Array, last: int) -> int:
    """Eliminate the unknowns from the last to `last` from a symmetric matrix, of which the lower half is read.

    Returns the number of pivots that are not positive: negative directions, by Sylvester's law of inertia.
    """
    negative = 0
    for p in range(ELEMENT - 1, last - 1, -1):
        pivot = k[p, p]
        if not pivot > 0.0:
            negative += 1
            if pivot == 0.0:
                pivot = -1e-300
        over = 1.0 / pivot
        for r in range(p):
            share = k[p, r] * over
            for c in range(r + 1):
                k[r, c] -= share * k[p, c]
    return negative


@leaf
def _interpolate_to_gauss_points(w: Array, x: Array, first: int, last: int, h: float) -> None:
    """Strains at the Gauss points of four steps from `first` on, by cubic Hermite, into the lanes of STAGE.

    last: the last node of the segment.
    """
    n = x.shape[0] // 2 - 1
    for i in range(LANES):
        j = min(first + i // 2, last - 1)
        t = 0.5 * (1.0 + (GAUSS if i % 2 else -GAUSS))
        back = 1.0 - t
        for c in range(6):
            a, b, a_s, b_s = x[j, c], x[j + 1, c], x[n + 1 + j, c], x[n + 2 + j, c]
            ends = back * back * (1.0 + 2.0 * t) * a + t * t * (3.0 - 2.0 * t) * b
            w[(STAGE + c) * LANES + i] = ends + h * t * back * (back * a_s - t * b_s)


@leaf
def _carry_over_joint(n: Triple, d: Triple, condensed: Array, moved: Array) -> None:
    """Express the condensed matrix (6, 6) of the part beyond a joint in the unknowns before it, in place.

    The displacement after a coupling is xi + theta x d, and the wrench n in it adds its own terms.
    """
    for r in range(NODE_UNKNOWNS):
        for c in range(NODE_UNKNOWNS):
            moved[r, c] = condensed[r, c]
    for r in range(NODE_UNKNOWNS):
        moved[r, 3] += condensed[r, 2] * d[1] - condensed[r, 1] * d[2]
        moved[r, 4] += condensed[r, 0] * d[2] - condensed[r, 2] * d[0]
        moved[r, 5] += condensed[r, 1] * d[0] - condensed[r, 0] * d[1]
    for c in range(NODE_UNKNOWNS):
        a, b, e = moved[0, c], moved[1, c], moved[2, c]
        for r in range(NODE_UNKNOWNS):
            condensed[r, c] = moved[r, c]
        condensed[3, c] += e * d[1] - b * d[2]
        condensed[4, c] += a * d[2] - e * d[0]
        condensed[5, c] += b * d[0] - a * d[1]
    _add_load_stiffness(n, d, condensed, 3)


@leaf
def _add_end(x: Array, j: int, end: Array, condensed: Array) -> None:
    """Add the terms of the load (19,) at the end of a segment, at node j."""
    d1, d2, d3 = rotation((x[j, 12], x[j, 13], x[j, 14], x[j, 15]))
    force, pull = three(end, 0), three(end, 13)
    _add_load_stiffness((dot(d1, force), dot(d2, force), dot(d3, force)), three(end, 10), condensed, 3)
    _add_load_stiffness((dot(d1, pull), dot(d2, pull), dot(d3, pull)), three(end, 16), condensed, 3)


@kernel
def negative_directions(rod: Rod, x: Array) -> int:
    """Number of independent directions that lower the potential energy of the solved arm x (2 N + 2, 16): 0 is stable.

    The inertia of the second variation in quadratic elements, one for each step along the arm, with two Gauss points.
    Eliminated from the tip to the base, a negative pivot is a conjugate point of the part beyond.
    """
    walls, line, negative = rod.walls, rod.line, 0
    h, b, hb = (
        np.zeros((STRAIN_UNKNOWNS, STRAIN_UNKNOWNS)),
        np.empty((3, STRAIN_UNKNOWNS, NODE_UNKNOWNS)),
        np.empty((STRAIN_UNKNOWNS, NODE_UNKNOWNS)),
    )
    k, condensed = np.zeros((ELEMENT, ELEMENT)), np.zeros((NODE_UNKNOWNS, NODE_UNKNOWNS))
    moved = np.empty((NODE_UNKNOWNS, NODE_UNKNOWNS))
    for s in range(line.step.shape[0] - 1, -1, -1):
        w, step, start, last = rod.work[s], line.step[s], line.first[s], line.first[s + 1] - 1
        if s < line.step.shape[0] - 1:
            after = rod.work[s + 1]
            for c in range(6):
                after[(STAGE + c) * LANES] = x[last + 1, c]
            resting_wrench(after, walls)
            _carry_over_joint(triple(after, WRENCH, 0), three(line.joint[s], 0), condensed, moved)
        _add_end(x, last, rod.ends[s], condensed)
        first = start + LANES // 2 * ((last - start - 1) // (LANES // 2))
        for begin in range(first, start - 1, -(LANES // 2)):
            _interpolate_to_gauss_points(w, x, begin, last, step)
            resting_wrench(w, walls)
            for e in range(min(begin + LANES // 2, last) - 1, begin - 1, -1):
                for r in range(ELEMENT):
                    for c in range(ELEMENT):
                        k[r, c] = 0.0
                for r in range(NODE_UNKNOWNS):
                    for c in range(NODE_UNKNOWNS):
                        k[2 * NODE_UNKNOWNS + r, 2 * NODE_UNKNOWNS + c] = condensed[r, c]
                for g in range(2):
                    i = 2 * (e - begin) + g
                    _fill_integrand(w, i, h)
                    soft = NEUTRAL * min(h[3, 3], min(h[4, 4], h[5, 5])) * (0.5 * math.pi / rod.length) ** 2
                    for r in range(6, STRAIN_UNKNOWNS):
                        h[r, r] -= soft
                    _add_gauss_point(w, i, GAUSS if g else -GAUSS, step, h, b, hb, k)
                negative += _eliminate(k, NODE_UNKNOWNS)
                for r in range(NODE_UNKNOWNS):
                    for c in range(r + 1):
                        condensed[r, c] = k[r, c]
                        condensed[c, r] = k[r, c]
    return negative


@kernel
def count_negative_directions(walls: Walls, arm_fields: Fields, x: Array) -> int:
    """`negative_directions` for Python, of an arm with its loads."""
    arm = ArmArguments(*arm_fields)
    return negative_directions(rod_of(arm, walls, arm.ends), x)  # type: ignore[no-any-return]


@kernel
def is_stable(rod: Rod, x: Array) -> bool:
    """Whether the solved arm x is stable: by the inequality, else by counting the negative directions."""
    if satisfies_stability_bound(rod, x):
        return True
    return bool(negative_directions(rod, x) == 0)
