"""Kernels on top of the solver: the arm's axis, whole motions, many arms."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.compiled import kernel
from model.march import advance, equilibrium
from model.shooting import Room
from model.triples import cross, leaf, plus, rotation

Array = Any


@leaf
def axis(x: Array, slope: Array, length: float, centre: Array, p: Array, rotations: Array, v: Array, u: Array) -> None:
    """Positions, orientations and strains of the arm's axis from the solved states of the line through the centroid.

    Integrates p' = R v (eq 7) by the trapezoid corrected with end slopes, of fourth order, then moves from the centroid
    to the axis as eq 29 does: p + centre - R centre.
    """
    n = x.shape[0] - 1
    h = length / n
    cx, cy = centre[0], centre[1]
    at, speed, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for j in range(n + 1):
        d1, d2, d3 = rotation((x[j, 12], x[j, 13], x[j, 14], x[j, 15]))
        strain, curvature = (x[j, 0], x[j, 1], x[j, 2]), (x[j, 3], x[j, 4], x[j, 5])
        g = plus((slope[j, 0], slope[j, 1], slope[j, 2]), 1.0, cross(curvature, strain))
        was, turned = speed, turn
        speed = plus(plus((strain[0] * d1[0], strain[0] * d1[1], strain[0] * d1[2]), strain[1], d2), strain[2], d3)
        turn = plus(plus((g[0] * d1[0], g[0] * d1[1], g[0] * d1[2]), g[1], d2), g[2], d3)
        if j > 0:
            at = plus(at, 0.5 * h, plus(was, 1.0, speed))
            at = plus(at, h * h / 12.0, plus(turned, -1.0, turn))
        for k in range(3):
            rotations[j, k, 0], rotations[j, k, 1], rotations[j, k, 2] = d1[k], d2[k], d3[k]
            p[j, k] = at[k] - d1[k] * cx - d2[k] * cy
        p[j, 0] += cx
        p[j, 1] += cy
        u1, u2, u3 = curvature
        v[j, 0], v[j, 1], v[j, 2] = strain[0] + u3 * cy, strain[1] - u3 * cx, strain[2] - u1 * cy + u2 * cx
        u[j, 0], u[j, 1], u[j, 2] = u1, u2, u3


@kernel
def motion(
    w: Array,
    law: int,
    actuators: int,
    rest: Array,
    per_pressure: Array,
    free: float,
    before: Array,
    pressure: Array,
    load: Array,
    loaded: bool,
    tip: Array,
    length: float,
    segments: int,
    scale: Array,
    scheme: Array,
    levels: Array,
    trail: Array,
    x: Array,
    slope: Array,
    room: Room,
    tolerance: float,
    centre: Array,
    tips: Array,
    turns: Array,
    good: Array,
) -> int:
    """Advance through the rows of pressure (T, N); fills tips (T, 3), turns (T, 3, 3), good (T,). Returns passes."""
    n = x.shape[0]
    p, turned, v, u = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3))
    total = 0
    for t in range(pressure.shape[0]):
        passes = advance(
            w, law, actuators, rest, per_pressure, free, before, pressure[t], load, loaded, tip, length, segments,
            scale, scheme, levels, trail, x, slope, room, tolerance,
        )  # fmt: skip
        good[t] = passes > 0
        if passes > 0:
            total += passes
        axis(x, slope, length, centre, p, turned, v, u)
        tips[t] = p[n - 1]
        turns[t] = turned[n - 1]
    return total


@kernel
def equilibria(
    works: Array,
    law: int,
    actuators: int,
    rests: Array,
    per_pressures: Array,
    free: Array,
    pressure: Array,
    load: Array,
    loaded: bool,
    tips: Array,
    length: Array,
    scale: Array,
    centre: Array,
    tolerance: float,
    room: Room,
    place: Array,
    turned: Array,
    good: Array,
) -> None:
    """One equilibrium per row of pressure (B, N), each with its own parameters; fills place, turned and good."""
    n = room.x.shape[0] - 1
    p, turns, v, u = np.empty((n + 1, 3)), np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((n + 1, 3))
    for b in range(pressure.shape[0]):
        k = b % works.shape[0]
        passes = equilibrium(
            works[k], law, actuators, rests[k], per_pressures[k], free[k], pressure[b], load[k], loaded, tips[k],
            length[k], scale[k], room, tolerance,
        )  # fmt: skip
        good[b] = passes > 0
        if passes > 0:
            axis(room.x, room.slope, length[k], centre[k], p, turns, v, u)
            place[b] = p[n]
            turned[b] = turns[n]
        else:
            place[b] = np.nan
            turned[b] = np.nan
