"""Kernels of the Maxwell branches of the walls: their strains, and the past strains that stand for them in a time step.

A branch with the relaxation time T has the elastic strain h, h' = y' - h / T. For a strain y that is linear over a step
of length dt this is exactly h_i = decay h_{i-1} + rise (y_i - y_{i-1}), with decay = exp(-dt / T) and
rise = (1 - decay) T / dt. So the stress of all branches and of the Kelvin-Voigt damping tau,

    K (tau (c0 y + y^h) + sum_k g_k h_k) = K theta (c0 y + y^p),    theta = tau + sum_k g_k rise_k / c0,

has the form of damping alone, with the past strains y^p = (tau y^h + sum_k g_k (decay_k h_k - rise_k y_{i-1})) / theta.
"""

from __future__ import annotations

from typing import Any

from model.kernels.arguments import Fields, Line
from model.kernels.layout import LANES, STATE
from model.kernels.vec3 import called, leaf

Array = Any


@leaf
def interpolate_midpoints(history: Array, size: int, line: Line) -> None:
    """Interpolate the history half-way between the nodes by cubic Hermite: values, and their derivatives.

    The derivative at the mid-point is of fourth order too: its leading error vanishes by symmetry. Joints have no
    mid-points.
    """
    for k in range(line.step.shape[0]):
        h = line.step[k]
        over = 1.5 / h
        for m in range(STATE * line.first[k], STATE * (line.first[k + 1] - 1)):
            a, b = history[m], history[STATE + m]
            a_s, b_s = history[size + m], history[size + STATE + m]
            history[2 * size + m] = 0.5 * (a + b) + 0.125 * h * (a_s - b_s)
            history[3 * size + m] = over * (b - a) - 0.25 * (a_s + b_s)


@leaf
def relax_branches(line: Line, factors: Array, strains: Array, now: Array, last: Array) -> None:
    """Advance the strains (B, 2 N + 2, 6) of the branches over a step from the states `last` to `now` (2 N + 2, 16).

    factors (K, 1 + B, 3), by segment: tau / theta, theta, 0; then for each branch g / theta, decay and rise.
    """
    nodes = now.shape[0] // 2
    for b in range(strains.shape[0]):
        for k in range(line.step.shape[0]):
            decay, rise = factors[k, 1 + b, 1], factors[k, 1 + b, 2]
            for at in range(2 * line.first[k], 2 * line.first[k + 1]):
                j = at // 2 + (at % 2) * nodes
                for c in range(6):
                    strains[b, j, c] = decay * strains[b, j, c] + rise * (now[j, c] - last[j, c])


@leaf
def compute_past_strains(
    line: Line, factors: Array, strains: Array, x: Array, history: Array, walls_past: Array
) -> None:
    """Fill the past strains of the walls at the nodes, and their derivatives, from y^h and the last states x."""
    nodes = x.shape[0] // 2
    for k in range(line.step.shape[0]):
        for at in range(2 * line.first[k], 2 * line.first[k + 1]):
            j = at // 2 + (at % 2) * nodes
            for c in range(6):
                walls_past[STATE * j + c] = factors[k, 0, 0] * history[STATE * j + c]
            for b in range(strains.shape[0]):
                share, decay, rise = factors[k, 1 + b, 0], factors[k, 1 + b, 1], factors[k, 1 + b, 2]
                for c in range(6):
                    walls_past[STATE * j + c] += share * (decay * strains[b, j, c] - rise * x[j, c])


@called
def update_midpoints(history: Array, size: int, line_fields: Fields) -> None:
    """`interpolate_midpoints` for Python."""
    interpolate_midpoints(history, size, Line(*line_fields))


@called
def update_past_strains(
    line_fields: Fields, factors: Array, strains: Array, x: Array, history: Array, past: Array
) -> None:
    """`compute_past_strains` for Python, with the values half-way between the nodes."""
    line = Line(*line_fields)
    compute_past_strains(line, factors, strains, x, history, past)
    interpolate_midpoints(past, x.size // 2, line)


@leaf
def relax_branch_lanes(
    line: Line, factors: Array, strains: Array, past: Array, now: Array, last: Array, slope: Array, last_slope: Array
) -> None:
    """The same for lanes: strains (B, N + 1, 96) of the branches, and the part of `past` behind the history.

    factors (K, 1 + B, 3, 8), by segment and lane. past (N + 1, 288): history, its derivatives, past strains and their
    derivatives.
    now, last, slope, last_slope: solutions (N + 1, 128) of the last two steps, and their derivatives.
    """
    half, own = 6 * LANES, 24 * LANES
    k = 0
    for j in range(past.shape[0]):
        if j == line.first[k + 1]:
            k += 1
        for c in range(6):
            for i in range(LANES):
                at = c * LANES + i
                past[j, own + at] = factors[k, 0, 0, i] * past[j, at]
                past[j, own + half + at] = factors[k, 0, 0, i] * past[j, 12 * LANES + at]
        for b in range(strains.shape[0]):
            for c in range(6):
                for i in range(LANES):
                    share, decay, rise = factors[k, 1 + b, 0, i], factors[k, 1 + b, 1, i], factors[k, 1 + b, 2, i]
                    at = c * LANES + i
                    strain = decay * strains[b, j, at] + rise * (now[j, at] - last[j, at])
                    bent = decay * strains[b, j, half + at] + rise * (slope[j, at] - last_slope[j, at])
                    strains[b, j, at], strains[b, j, half + at] = strain, bent
                    past[j, own + at] += share * (decay * strain - rise * now[j, at])
                    past[j, own + half + at] += share * (decay * bent - rise * slope[j, at])
