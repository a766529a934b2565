"""Eq 27 as printed, compiled: one scalar run of the neutral axis from base to tip, by Euler's method or RK4."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from model.kernels.jit import kernel

Array = Any

STATE = 19  # p (3), h (4), n (3), m (3), q (3), w (3): base frame for p, n, m, section frame for q, w
SAMPLE = 12  # v, u, q, w
_called = partial(kernel, sources=(__file__,))
_inner = partial(kernel, sources=(__file__,), called=False)


class SectionArguments(NamedTuple):
    """The section of the rod and the time scheme's c0.

    soft_se, soft_bt (3, 3): inverse stiffnesses. inertia: rho J (3, 3). push (N,): P_i A_i + the RPE's E_i A_m v.
    arms (N, 3): r_i - D.
    """

    c0: float
    soft_se: Array
    soft_bt: Array
    rest_v: Array
    rest_u: Array
    mass: float
    inertia: Array
    push: Array
    arms: Array


class RodArguments(NamedTuple):
    """What one run along the neutral axis needs beside the base loads.

    history (steps + 1, 12): y^h of (v, u, q, w) at the nodes; half-way between them RK4 takes the mean. load
    (steps + 1, 6): f_e, l_e. tip: F^g (3), F^e (3), L^e (3). weight_arm: where the weight hangs, from the neutral axis,
    in the section frame (-D by eq 29).
    """

    euler: bool
    steps: int
    length: float
    history: Array
    load: Array
    section: SectionArguments
    tip: Array
    weight_arm: Array


@_inner
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@_called
def turn(h: Array, r: Array) -> None:
    """The rotation matrix of a quaternion (eq 9)."""
    a, b, c, d = h[0], h[1], h[2], h[3]
    s = 2.0 / (a * a + b * b + c * c + d * d)
    r[0, 0], r[0, 1], r[0, 2] = 1.0 - s * (c * c + d * d), s * (b * c - d * a), s * (b * d + c * a)
    r[1, 0], r[1, 1], r[1, 2] = s * (b * c + d * a), 1.0 - s * (b * b + d * d), s * (c * d - b * a)
    r[2, 0], r[2, 1], r[2, 2] = s * (b * d - c * a), s * (c * d + b * a), 1.0 - s * (b * b + c * c)


@_inner
def slopes(y: Array, history: Array, load: Array, section: SectionArguments, dy: Array, sample: Array) -> None:
    """Eq 27: dy/ds (19,) of the state y, and the sample (v, u, q, w) from which the next history is made.

    history (12,), load (6,): at this place of the axis.
    """
    c0, soft_se, soft_bt, rest_v, rest_u, mass, inertia, push, arms = section
    r = np.empty((3, 3))
    turn(y[3:7], r)
    n, m, q, w = y[7:10], y[10:13], y[13:16], y[16:19]
    v, u = sample[0:3], sample[3:6]
    for i in range(3):
        v[i], u[i] = rest_v[i], rest_u[i]
    for k in range(3):
        nk = r[0, k] * n[0] + r[1, k] * n[1] + r[2, k] * n[2]
        mk = r[0, k] * m[0] + r[1, k] * m[1] + r[2, k] * m[2]
        for i in range(3):
            v[i] += soft_se[i, k] * nk
            u[i] += soft_bt[i, k] * mk
    sample[6:9] = q
    sample[9:12] = w
    force, moment, side, lever = np.zeros(3), np.zeros(3), np.empty(3), np.empty(3)
    # u-hat e3 = (u2, -u1, 0).
    bent = np.array((u[1], -u[0], 0.0))
    total = 0.0
    for i in range(push.shape[0]):
        total += push[i]
        _cross(u, arms[i], side)
        for k in range(3):
            side[k] += v[k]
        # x cross e3 = (x2, -x1, 0).
        moment[0] += push[i] * side[1]
        moment[1] -= push[i] * side[0]
        _cross(arms[i], bent, lever)
        for k in range(3):
            moment[k] += push[i] * lever[k]
    spin, drag = np.empty(3), np.empty(3)
    _cross(w, q, spin)
    for k in range(3):
        force[k] = total * bent[k] + mass * (spin[k] + c0 * q[k] + history[6 + k])
    momentum, spun, swirl = np.zeros(3), np.zeros(3), np.empty(3)
    for k in range(3):
        for i in range(3):
            momentum[k] += inertia[k, i] * w[i]
            spun[k] += inertia[k, i] * (c0 * w[i] + history[9 + i])
    _cross(w, momentum, swirl)
    for k in range(3):
        moment[k] += swirl[k] + spun[k]
    ps = np.empty(3)
    for k in range(3):
        ps[k] = r[k, 0] * v[0] + r[k, 1] * v[1] + r[k, 2] * v[2]
        dy[k] = ps[k]
    dy[3] = -0.5 * (u[0] * y[4] + u[1] * y[5] + u[2] * y[6])
    dy[4] = 0.5 * (u[0] * y[3] + u[2] * y[5] - u[1] * y[6])
    dy[5] = 0.5 * (u[1] * y[3] - u[2] * y[4] + u[0] * y[6])
    dy[6] = 0.5 * (u[2] * y[3] + u[1] * y[4] - u[0] * y[5])
    _cross(ps, n, drag)
    for k in range(3):
        dy[7 + k] = -load[k] + r[k, 0] * force[0] + r[k, 1] * force[1] + r[k, 2] * force[2]
        dy[10 + k] = -load[3 + k] - drag[k] + r[k, 0] * moment[0] + r[k, 1] * moment[1] + r[k, 2] * moment[2]
    swept, turned = np.empty(3), np.empty(3)
    _cross(w, v, swept)
    _cross(u, q, turned)
    for k in range(3):
        dy[13 + k] = swept[k] + c0 * v[k] + history[k] - turned[k]
    _cross(w, u, swept)
    for k in range(3):
        dy[16 + k] = swept[k] + c0 * u[k] + history[3 + k]


@_called
def shoot(guess: Array, rod: RodArguments, states: Array, samples: Array) -> Array:
    """The residual E(G) (6,) of eq 28 for base loads G = (n, m). Fills states (N + 1, 19) and samples (N + 1, 12)."""
    history, load, section, tip = rod.history, rod.load, rod.section, rod.tip
    push, arms = section.push, section.arms
    h = rod.length / rod.steps
    y, stage = np.zeros(STATE), np.empty(STATE)
    k1, k2, k3, k4 = np.empty(STATE), np.empty(STATE), np.empty(STATE), np.empty(STATE)
    half, sample, spare = np.empty(SAMPLE), np.empty(SAMPLE), np.empty(SAMPLE)
    half_load = np.empty(6)
    y[3] = 1.0
    y[7:13] = guess
    for j in range(rod.steps + 1):
        slopes(y, history[j], load[j], section, k1, sample)
        states[j, :] = y
        samples[j, :] = sample
        if j == rod.steps:
            break
        if rod.euler:
            for i in range(STATE):
                y[i] += h * k1[i]
            continue
        for i in range(SAMPLE):
            half[i] = 0.5 * (history[j, i] + history[j + 1, i])
        for i in range(6):
            half_load[i] = 0.5 * (load[j, i] + load[j + 1, i])
        for i in range(STATE):
            stage[i] = y[i] + 0.5 * h * k1[i]
        slopes(stage, half, half_load, section, k2, spare)
        for i in range(STATE):
            stage[i] = y[i] + 0.5 * h * k2[i]
        slopes(stage, half, half_load, section, k3, spare)
        for i in range(STATE):
            stage[i] = y[i] + h * k3[i]
        slopes(stage, history[j + 1], load[j + 1], section, k4, spare)
        for i in range(STATE):
            y[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    r = np.empty((3, 3))
    turn(y[3:7], r)
    force, moment, lever = np.zeros(3), np.zeros(3), np.empty(3)
    for i in range(push.shape[0]):
        force[2] += push[i]
        moment[0] += push[i] * arms[i, 1]
        moment[1] -= push[i] * arms[i, 0]
    hung, arm = np.empty(3), np.empty(3)
    for k in range(3):
        arm[k] = r[k, 0] * rod.weight_arm[0] + r[k, 1] * rod.weight_arm[1] + r[k, 2] * rod.weight_arm[2]
    _cross(arm, tip[:3], hung)
    _cross(arm, tip[3:6], lever)
    residual = np.empty(6)
    for k in range(3):
        ended = r[k, 0] * force[0] + r[k, 1] * force[1] + r[k, 2] * force[2]
        residual[k] = y[7 + k] - tip[k] - ended - tip[3 + k]
        ended = r[k, 0] * moment[0] + r[k, 1] * moment[1] + r[k, 2] * moment[2]
        residual[3 + k] = y[10 + k] - hung[k] - ended - tip[6 + k] - lever[k]
    return residual


@_called
def jacobian(guess: Array, rod: RodArguments, states: Array, samples: Array) -> Array:
    """dE/dG (6, 6) by one-sided differences; the steps are absolute, for a load that happens to be zero is no less."""
    at = shoot(guess, rod, states, samples)
    out, moved = np.empty((6, 6)), guess.copy()
    for k in range(6):
        step = 1e-6 if k < 3 else 1e-7
        moved[k] = guess[k] + step
        there = shoot(moved, rod, states, samples)
        for i in range(6):
            out[i, k] = (there[i] - at[i]) / step
        moved[k] = guess[k]
    return out
