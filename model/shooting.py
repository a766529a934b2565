"""Newton's method on the rod's boundary value problem: simple or multiple shooting from the base.

The rod is cut into segments, each with a guessed state at its start. One pass integrates every segment in eight lanes:
the guess, six perturbed along directions that span what the clamped base leaves free, and one along the particular
solution that closes the gaps between segments. The directions are made orthonormal again at every cut (Godunov, Conte),
so growing modes, which overflow simple shooting at small time steps, cannot swamp the others. One segment is simple
shooting.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from model.compiled import kernel
from model.layout import LANES, NODE, SLOPE, STAGE, STATE, WRENCH
from model.linear import orthonormalise, solve_six
from model.rod import integrate, slopes, stage_wrench

Array = Any

STEP = 1e-6  # of the one-sided differences, in scaled states
LONGEST = 1.5  # of a Newton update, in scaled strains and orientations


@kernel
def tip_residual(w: Array, law: int, actuators: int, history: Array, row: int, tip: Array, c0: float, r: Array) -> None:
    """What the tip's total wrench lacks of what hangs on it (eqs 23-25, 28), per lane: r (8, 6) [N, N m].

    tip: dead force (3) and moment (3) in the base frame, cap mass that resists acceleration, cap inertia (3), place of
    the load in the section (3).
    """
    for i in range(STATE * LANES):
        w[STAGE * LANES + i] = w[NODE * LANES + i]
    stage_wrench(w, law, actuators, history, row)
    for i in range(LANES):
        a, b = w[(NODE + 12) * LANES + i], w[(NODE + 13) * LANES + i]
        c, d = w[(NODE + 14) * LANES + i], w[(NODE + 15) * LANES + i]
        s = 2.0 / (a * a + b * b + c * c + d * d)
        r11, r12, r13 = 1.0 - s * (c * c + d * d), s * (b * c - d * a), s * (b * d + c * a)
        r21, r22, r23 = s * (b * c + d * a), 1.0 - s * (b * b + d * d), s * (c * d - b * a)
        r31, r32, r33 = s * (b * d - c * a), s * (c * d + b * a), 1.0 - s * (b * b + c * c)
        f1 = r11 * tip[0] + r21 * tip[1] + r31 * tip[2]
        f2 = r12 * tip[0] + r22 * tip[1] + r32 * tip[2]
        f3 = r13 * tip[0] + r23 * tip[1] + r33 * tip[2]
        l1 = r11 * tip[3] + r21 * tip[4] + r31 * tip[5]
        l2 = r12 * tip[3] + r22 * tip[4] + r32 * tip[5]
        l3 = r13 * tip[3] + r23 * tip[4] + r33 * tip[5]
        mass, j1, j2, j3 = tip[6], tip[7], tip[8], tip[9]
        x, y, z = tip[10], tip[11], tip[12]
        if mass > 0.0 or j1 > 0.0 or j2 > 0.0 or j3 > 0.0:
            q1, q2, q3 = w[(NODE + 6) * LANES + i], w[(NODE + 7) * LANES + i], w[(NODE + 8) * LANES + i]
            w1, w2, w3 = w[(NODE + 9) * LANES + i], w[(NODE + 10) * LANES + i], w[(NODE + 11) * LANES + i]
            t1, t2, t3 = c0 * w1 + history[row, 9], c0 * w2 + history[row, 10], c0 * w3 + history[row, 11]
            g1, g2, g3 = q1 + w2 * z - w3 * y, q2 + w3 * x - w1 * z, q3 + w1 * y - w2 * x
            f1 -= mass * (c0 * q1 + history[row, 6] + t2 * z - t3 * y + w2 * g3 - w3 * g2)
            f2 -= mass * (c0 * q2 + history[row, 7] + t3 * x - t1 * z + w3 * g1 - w1 * g3)
            f3 -= mass * (c0 * q3 + history[row, 8] + t1 * y - t2 * x + w1 * g2 - w2 * g1)
            l1 -= j1 * t1 + (j3 - j2) * w2 * w3
            l2 -= j2 * t2 + (j1 - j3) * w3 * w1
            l3 -= j3 * t3 + (j2 - j1) * w1 * w2
        l1 += y * f3 - z * f2
        l2 += z * f1 - x * f3
        l3 += x * f2 - y * f1
        r[i, 0] = w[WRENCH * LANES + i] - f1
        r[i, 1] = w[(WRENCH + 1) * LANES + i] - f2
        r[i, 2] = w[(WRENCH + 2) * LANES + i] - f3
        r[i, 3] = w[(WRENCH + 3) * LANES + i] - l1
        r[i, 4] = w[(WRENCH + 4) * LANES + i] - l2
        r[i, 5] = w[(WRENCH + 5) * LANES + i] - l3


@kernel
def newton(
    w: Array,
    law: int,
    actuators: int,
    history: Array,
    load: Array,
    loaded: bool,
    tip: Array,
    c0: float,
    length: float,
    segments: int,
    scale: Array,
    x: Array,
    slope: Array,
    states: Array,
    derivatives: Array,
    tolerance: float,
    most: int,
) -> int:
    """Solve for the states x (N + 1, 16) at the nodes, and their slopes, from a guess in x; N divides by `segments`.

    Stops when the last update, in units of `scale`, is below `tolerance`; the error left is of the order of its
    square, because all nodes are moved along the computed directions. Returns the number of passes, or -1.
    """
    n = x.shape[0] - 1
    per = n // segments
    h = length / n
    directions = np.zeros((segments, 7, STATE))
    triangle = np.zeros((segments, 6, 6))
    along = np.zeros((segments, 6))
    weights = np.zeros((segments, 7))
    reach = np.zeros(segments)
    matrix, right = np.empty((6, 6)), np.empty(6)
    r = np.empty((LANES, 6))
    end = np.empty((segments, STATE))
    previous = np.inf
    for passes in range(1, most + 1):
        for k in range(6):
            for c in range(STATE):
                directions[0, k, c] = 1.0 if c == k else 0.0
        for s in range(segments):
            particular = 0.0
            for c in range(STATE):
                particular += directions[s, 6, c] ** 2
            reach[s] = STEP / particular**0.5 if particular > 0.0 else 0.0
            for c in range(STATE):
                at, unit = (NODE + c) * LANES, scale[c]
                w[at] = x[s * per, c]
                for k in range(6):
                    w[at + 1 + k] = x[s * per, c] + STEP * unit * directions[s, k, c]
                w[at + 7] = x[s * per, c] + reach[s] * unit * directions[s, 6, c]
            integrate(w, law, actuators, history, load, loaded, s * per, (s + 1) * per, h, states, derivatives)
            for c in range(STATE):
                end[s, c] = w[(NODE + c) * LANES]
            if s == segments - 1:
                break
            for c in range(STATE):
                at = (NODE + c) * LANES
                over = 1.0 / (STEP * scale[c])
                for k in range(6):
                    directions[s + 1, k, c] = (w[at + 1 + k] - w[at]) * over
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
        last = segments - 1
        for i in range(STATE * LANES):
            states[n, i] = w[NODE * LANES + i]
        tip_residual(w, law, actuators, history, 2 * n, tip, c0, r)
        for i in range(6):
            carried = (r[7, i] - r[0, i]) / reach[last] if reach[last] > 0.0 else 0.0
            right[i] = -r[0, i] - carried
            for k in range(6):
                matrix[i, k] = (r[k + 1, i] - r[0, i]) / STEP
        if not solve_six(matrix, right):
            return -1
        for s in range(last, -1, -1):
            for k in range(6):
                weights[s, k] = right[k] / STEP
            weights[s, 6] = 1.0 / reach[s] if reach[s] > 0.0 else 0.0
            if s > 0:
                for k in range(5, -1, -1):
                    total = right[k] - along[s, k]
                    for c in range(k + 1, 6):
                        total -= triangle[s, k, c] * right[c]
                    right[k] = total / triangle[s, k, k]
        largest, bent = 0.0, 0.0
        for s in range(segments):
            for j in range(s * per, (s + 1) * per + (1 if s == last else 0)):
                for c in range(STATE):
                    at = c * LANES
                    move = 0.0
                    for k in range(7):
                        move += weights[s, k] * (states[j, at + 1 + k] - states[j, at])
                    x[j, c] = move
                    size = abs(move) / scale[c]
                    # A plain maximum would swallow a NaN and call the step solved.
                    if not size <= largest:
                        largest = size
                        if not size < np.inf:
                            return -1
                    if size > bent and (c < 6 or c >= 12):
                        bent = size
        if largest > 4.0 * previous and largest > 1.0:
            return -1
        previous = largest
        # Strain and orientation make the equations nonlinear; velocities may move as far as they like.
        damping = 1.0 if bent <= LONGEST else LONGEST / bent
        for j in range(n + 1):
            for c in range(STATE):
                x[j, c] = states[j, c * LANES] + damping * x[j, c]
        if largest < tolerance:
            for s in range(segments):
                for j in range(s * per, (s + 1) * per):
                    for c in range(STATE):
                        at = c * LANES
                        move = 0.0
                        for k in range(7):
                            move += weights[s, k] * (derivatives[j, at + 1 + k] - derivatives[j, at])
                        slope[j, c] = derivatives[j, at] + move
            for c in range(STATE):
                for i in range(LANES):
                    w[(STAGE + c) * LANES + i] = x[n, c]
            slopes(w, law, actuators, history, load, loaded, 2 * n)
            for c in range(STATE):
                slope[n, c] = w[(SLOPE + c) * LANES]
            return passes
    return -1
