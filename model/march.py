"""Kernels that solve the rod: one equilibrium, one time step, and the axis of what was solved."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.compiled import kernel
from model.layout import (
    HISTORY,
    LANES,
    MORE,
    NODE,
    OFFSET,
    PER_TUBE,
    RATE,
    SLOPE,
    STAGE,
    STATE,
    TRIO,
    WRENCH,
)
from model.rod import integrate, stage_wrench, strain_changes
from model.shooting import newton

Array = Any


@kernel
def set_pressures(w: Array, actuators: int, rest: Array, per_pressure: Array, free: float, pressure: Array) -> None:
    """Write what the pressures [Pa] do into the parameters of all lanes; free is the RPE's strain per pascal."""
    for c in range(6):
        total = rest[c]
        for k in range(actuators):
            total += per_pressure[c, k] * pressure[k]
        for i in range(LANES):
            w[(OFFSET + c) * LANES + i] = total
    first = TRIO if actuators <= 3 else MORE
    for k in range(actuators):
        for i in range(LANES):
            w[(first + PER_TUBE * k + 2) * LANES + i] = free * pressure[k]


@kernel
def uniform_guess(w: Array, law: int, actuators: int, history: Array, tip: Array, scale: Array, x: Array) -> None:
    """Fill x with the strains that the section would have everywhere if the tip's load did not turn with the arm."""
    n = x.shape[0] - 1
    for i in range(LANES):
        for c in range(STATE):
            w[(STAGE + c) * LANES + i] = 1.0 if c in (2, 12) else 0.0
    for _ in range(8):
        stage_wrench(w, law, actuators, history, 0)
        for i in range(LANES):
            w[RATE * LANES + i] = tip[0] - w[WRENCH * LANES + i]
            w[(RATE + 1) * LANES + i] = tip[1] - w[(WRENCH + 1) * LANES + i]
            w[(RATE + 2) * LANES + i] = tip[2] - w[(WRENCH + 2) * LANES + i]
            w[(RATE + 3) * LANES + i] = tip[3] - w[(WRENCH + 3) * LANES + i]
            w[(RATE + 4) * LANES + i] = tip[4] - w[(WRENCH + 4) * LANES + i]
            w[(RATE + 5) * LANES + i] = tip[5] - w[(WRENCH + 5) * LANES + i]
        strain_changes(w, law)
        largest = 0.0
        for c in range(6):
            for i in range(LANES):
                w[(STAGE + c) * LANES + i] += w[(SLOPE + c) * LANES + i]
            largest = max(largest, abs(w[(SLOPE + c) * LANES]) / scale[c])
        if largest < 1e-6:
            break
    for c in range(STATE):
        for j in range(n + 1):
            x[j, c] = w[(STAGE + c) * LANES]


@kernel
def equilibrium(
    w: Array,
    law: int,
    actuators: int,
    rest: Array,
    per_pressure: Array,
    free: float,
    pressure: Array,
    load: Array,
    loaded: bool,
    tip: Array,
    length: float,
    scale: Array,
    x: Array,
    slope: Array,
    tolerance: float,
) -> int:
    """Solve the static rod into x (N + 1, 16) from scratch. Returns the number of passes, or -1.

    First by simple shooting from a uniform guess; where that fails, by following the loads up from nothing.
    """
    n = x.shape[0] - 1
    history = np.zeros((2 * n + 1, HISTORY))
    states, derivatives = np.empty((n + 1, STATE * LANES)), np.empty((n + 1, STATE * LANES))
    set_pressures(w, actuators, rest, per_pressure, free, pressure)
    uniform_guess(w, law, actuators, history, tip, scale, x)
    passes = newton(
        w, law, actuators, history, load, loaded, tip, 0.0, length, 1, scale, x, slope, states, derivatives,
        tolerance, 20,
    )  # fmt: skip
    if passes > 0:
        return int(passes)
    segments = _divisor(n, 4)
    some, some_load, some_tip = np.empty_like(pressure), np.empty_like(load), tip.copy()
    done, stride, total = 0.0, 0.25, 0
    set_pressures(w, actuators, rest, per_pressure, free, np.zeros_like(pressure))
    uniform_guess(w, law, actuators, history, np.zeros_like(tip), scale, x)
    for c in range(STATE):
        for i in range(LANES):
            w[(NODE + c) * LANES + i] = x[0, c]
    integrate(w, law, actuators, history, np.zeros_like(load), False, 0, n, length / n, states, derivatives)
    for j in range(n):
        for c in range(STATE):
            x[j, c] = states[j, c * LANES]
    good = x.copy()
    while done < 1.0:
        share = min(1.0, done + stride)
        some[:] = share * pressure
        some_load[:] = share * load
        some_tip[:6] = share * tip[:6]
        set_pressures(w, actuators, rest, per_pressure, free, some)
        passes = newton(
            w, law, actuators, history, some_load, loaded, some_tip, 0.0, length, segments, scale, x, slope, states,
            derivatives, tolerance, 30,
        )  # fmt: skip
        if passes > 0:
            total += passes
            done, stride = share, 2.0 * stride
            good[:] = x
        else:
            stride *= 0.25
            x[:] = good
            if stride < 1e-3:
                return -1
    return total


@kernel
def _divisor(n: int, wanted: int) -> int:
    """The smallest divisor of n that is at least `wanted`."""
    for d in range(max(1, wanted), n + 1):
        if n % d == 0:
            return d
    return n


@kernel
def sample_history(x: Array, slope: Array, h: float, out: Array) -> None:
    """Velocities and strains, and the strains' slopes, at nodes and mid-points (2 N + 1, 18), by cubic Hermite.

    The mid-point's slope from the same cubic is of fourth order too: its leading error vanishes by symmetry.
    """
    n = x.shape[0] - 1
    for j in range(n + 1):
        for c in range(12):
            out[2 * j, c] = x[j, c]
        for c in range(6):
            out[2 * j, 12 + c] = slope[j, c]
    for j in range(n):
        for c in range(12):
            out[2 * j + 1, c] = 0.5 * (x[j, c] + x[j + 1, c]) + 0.125 * h * (slope[j, c] - slope[j + 1, c])
        for c in range(6):
            out[2 * j + 1, 12 + c] = 1.5 * (x[j + 1, c] - x[j, c]) / h - 0.25 * (slope[j, c] + slope[j + 1, c])


@kernel
def advance(
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
    tolerance: float,
) -> int:
    """One time step. Returns the number of passes, or -1, in which case nothing but the work array has changed.

    scheme: c0, c1, c2, c3, d1. levels (4, 2 N + 1, 18): the last three samples, and the time derivative of the last.
    trail (3, N + 1, 16) and before (3, N): the last three solutions and their pressures, for the guess: extrapolated
    where extrapolation foretells the pressures better than the last ones do. Where that fails: more segments, then the
    pressures led from the last ones to the new ones in parts.
    """
    n = x.shape[0] - 1
    h = length / n
    c0 = scheme[0]
    history = np.empty((2 * n + 1, HISTORY))
    for j in range(2 * n + 1):
        for c in range(HISTORY):
            history[j, c] = (
                scheme[1] * levels[0, j, c]
                + scheme[2] * levels[1, j, c]
                + scheme[3] * levels[2, j, c]
                + scheme[4] * levels[3, j, c]
            )
    states, derivatives = np.empty((n + 1, STATE * LANES)), np.empty((n + 1, STATE * LANES))
    y, z = np.empty_like(x), np.empty_like(slope)
    set_pressures(w, actuators, rest, per_pressure, free, pressure)
    ahead, off = 0.0, 0.0
    for k in range(actuators):
        off += abs(pressure[k] - before[0, k])
        ahead += abs(pressure[k] - 3.0 * (before[0, k] - before[1, k]) - before[2, k])
    if ahead <= off:
        for j in range(n + 1):
            for c in range(STATE):
                y[j, c] = 3.0 * (trail[0, j, c] - trail[1, j, c]) + trail[2, j, c]
    else:
        y[:] = trail[0]
    passes = newton(
        w, law, actuators, history, load, loaded, tip, c0, length, segments, scale, y, z, states, derivatives,
        tolerance, 8,
    )  # fmt: skip
    if passes < 0:
        finer = _divisor(n, max(4, 2 * segments))
        y[:] = trail[0]
        passes = newton(
            w, law, actuators, history, load, loaded, tip, c0, length, finer, scale, y, z, states, derivatives,
            tolerance, 25,
        )  # fmt: skip
        if passes < 0:
            y[:] = trail[0]
            some = np.empty_like(pressure)
            parts = 8
            for part in range(1, parts + 1):
                some[:] = before[0] + (pressure - before[0]) * (part / parts)
                set_pressures(w, actuators, rest, per_pressure, free, some)
                passes = newton(
                    w, law, actuators, history, load, loaded, tip, c0, length, finer, scale, y, z, states, derivatives,
                    tolerance, 40,
                )  # fmt: skip
                if passes < 0:
                    return -1
    for j in range(n + 1):
        size = (y[j, 12] ** 2 + y[j, 13] ** 2 + y[j, 14] ** 2 + y[j, 15] ** 2) ** 0.5
        for c in range(12, 16):
            y[j, c] /= size
        for c in range(STATE):
            trail[2, j, c] = trail[1, j, c]
            trail[1, j, c] = trail[0, j, c]
            trail[0, j, c] = y[j, c]
            x[j, c] = y[j, c]
            slope[j, c] = z[j, c]
    before[2] = before[1]
    before[1] = before[0]
    before[0] = pressure
    for j in range(2 * n + 1):
        for c in range(HISTORY):
            levels[2, j, c] = levels[1, j, c]
            levels[1, j, c] = levels[0, j, c]
    sample_history(x, slope, h, levels[0])
    for j in range(2 * n + 1):
        for c in range(HISTORY):
            levels[3, j, c] = c0 * levels[0, j, c] + history[j, c]
    return int(passes)
