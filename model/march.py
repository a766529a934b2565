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
    STRIDE,
    TRIO,
    WRENCH,
)
from model.rod import integrate, stage_wrench, strain_changes
from model.shooting import Room, newton
from model.triples import leaf

Array = Any


@leaf
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


@leaf
def uniform_guess(w: Array, law: int, actuators: int, tip: Array, scale: Array, room: Room) -> None:
    """Fill x with the strains that the section would have everywhere if the tip's load did not turn with the arm."""
    x = room.x
    n = x.shape[0] - 1
    for i in range(LANES):
        for c in range(STATE):
            w[(STAGE + c) * LANES + i] = 1.0 if c in (2, 12) else 0.0
    for _ in range(8):
        stage_wrench(w, law, actuators, room.history, 0)
        for c in range(6):
            for i in range(LANES):
                w[(RATE + c) * LANES + i] = tip[c] - w[(WRENCH + c) * LANES + i]
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


@leaf
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
    room: Room,
    tolerance: float,
) -> int:
    """Solve the static rod into room.x and room.slope from scratch. Returns the number of passes, or -1.

    First by simple shooting from a uniform guess; where that fails, by following the loads up from nothing.
    """
    for j in range(room.history.shape[0]):
        room.history[j] = 0.0
    set_pressures(w, actuators, rest, per_pressure, free, pressure)
    uniform_guess(w, law, actuators, tip, scale, room)
    segments = _divisor(room.x.shape[0] - 1, 1)
    passes = newton(w, law, actuators, load, loaded, tip, 0.0, length, segments, scale, room, tolerance, 20.0)
    if passes > 0:
        return int(passes)
    return int(
        _followed(
            w, law, actuators, rest, per_pressure, free, pressure, load, loaded, tip, length, scale, room, tolerance
        )
    )


@kernel
def _followed(
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
    room: Room,
    tolerance: float,
) -> int:
    """The equilibrium by following pressures and loads up from nothing."""
    x = room.x
    n = x.shape[0] - 1
    nothing = np.zeros_like(pressure)
    set_pressures(w, actuators, rest, per_pressure, free, nothing)
    uniform_guess(w, law, actuators, np.zeros_like(tip), scale, room)
    for c in range(STATE):
        for i in range(LANES):
            w[(NODE + c) * LANES + i] = x[0, c]
    for i in range(LANES):
        w[STRIDE * LANES + i] = length / n
    none = np.zeros_like(load)
    for j in range(n):
        integrate(w, law, actuators, room.history, none, loaded, j, j + 1, room.states, room.derivatives)
        for c in range(STATE):
            x[j, c] = room.states[j, c * LANES]
    return int(
        _led(
            w, law, actuators, rest, per_pressure, free, nothing, pressure, load, loaded, tip, 0.0, length,
            _divisor(n, 4), scale, room, tolerance,
        )
    )  # fmt: skip


@kernel
def _led(
    w: Array,
    law: int,
    actuators: int,
    rest: Array,
    per_pressure: Array,
    free: float,
    last: Array,
    pressure: Array,
    load: Array,
    loaded: bool,
    tip: Array,
    c0: float,
    length: float,
    segments: int,
    scale: Array,
    room: Room,
    tolerance: float,
) -> int:
    """Lead the pressures from the last ones to the new ones, and at rest the loads, in strides as long as succeed."""
    x = room.x
    good, some, some_load, some_tip = x.copy(), np.empty_like(pressure), load.copy(), tip.copy()
    done, stride, total = 0.0, 0.125, 0
    while done < 1.0:
        share = min(1.0, done + stride)
        some[:] = last + (pressure - last) * share
        if c0 == 0.0:
            some_load[:] = share * load
            some_tip[:6] = share * tip[:6]
        set_pressures(w, actuators, rest, per_pressure, free, some)
        passes = newton(
            w, law, actuators, some_load, loaded, some_tip, c0, length, segments, scale, room, tolerance, 40.0
        )
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


@leaf
def _divisor(n: int, wanted: int) -> int:
    """The smallest divisor of n that is at least `wanted`."""
    for d in range(max(1, wanted), n + 1):
        if n % d == 0:
            return d
    return n


@leaf
def sample_history(x: Array, slope: Array, h: float, out: Array) -> None:
    """Velocities and strains, and the strains' slopes, at nodes and mid-points (2 N + 1 rows of 18), by cubic Hermite.

    The mid-point's slope from the same cubic is of fourth order too: its leading error vanishes by symmetry.
    """
    n = x.shape[0] - 1
    over = 1.5 / h
    for j in range(n + 1):
        at = 2 * HISTORY * j
        for c in range(12):
            out[at + c] = x[j, c]
        for c in range(6):
            out[at + 12 + c] = slope[j, c]
    for j in range(n):
        at = 2 * HISTORY * j + HISTORY
        for c in range(12):
            out[at + c] = 0.5 * (x[j, c] + x[j + 1, c]) + 0.125 * h * (slope[j, c] - slope[j + 1, c])
        for c in range(6):
            out[at + 12 + c] = over * (x[j + 1, c] - x[j, c]) - 0.25 * (slope[j, c] + slope[j + 1, c])


@leaf
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
    room: Room,
    tolerance: float,
) -> int:
    """One time step. Returns the number of passes, or -1, in which case nothing but work array and room has changed.

    scheme: c0, c1, c2, c3, d1. levels (4, (2 N + 1) 18): the last three samples, and the time derivative of the last.
    trail (2, N + 1, 16): the two solutions before x, where segments start; before (3, N): the last three's pressures;
    both for the guess, extrapolated where extrapolation foretells the pressures better than the last ones do. Where
    that fails: more segments, then the pressures led from the last ones to the new ones in parts.
    """
    n = x.shape[0] - 1
    c0, history, y, z = scheme[0], room.history, room.x, room.slope
    new, old, older, rate = levels[0], levels[1], levels[2], levels[3]
    c1, c2, c3, d1 = scheme[1], scheme[2], scheme[3], scheme[4]
    samples = history.shape[0]
    for j in range(samples):
        history[j] = c1 * new[j] + c2 * old[j] + c3 * older[j] + d1 * rate[j]
    set_pressures(w, actuators, rest, per_pressure, free, pressure)
    ahead, off = 0.0, 0.0
    for k in range(actuators):
        off += abs(pressure[k] - before[0, k])
        ahead += abs(pressure[k] - 3.0 * (before[0, k] - before[1, k]) - before[2, k])
    _guess(x, trail, ahead <= off, segments, y)
    passes = newton(w, law, actuators, load, loaded, tip, c0, length, segments, scale, room, tolerance, 8.0)
    if passes < 0:
        finer = _divisor(n, max(4, 2 * segments))
        _guess(x, trail, False, finer, y)
        passes = newton(w, law, actuators, load, loaded, tip, c0, length, finer, scale, room, tolerance, 25.0)
        if passes < 0:
            _guess(x, trail, False, finer, y)
            passes = _led(
                w, law, actuators, rest, per_pressure, free, before[0], pressure, load, loaded, tip, c0, length,
                finer, scale, room, tolerance,
            )  # fmt: skip
            if passes < 0:
                return -1
    for j in range(n + 1):
        over = 1.0 / (y[j, 12] ** 2 + y[j, 13] ** 2 + y[j, 14] ** 2 + y[j, 15] ** 2) ** 0.5
        for c in range(12, 16):
            y[j, c] *= over
    for j in range(0, n, n // segments):
        for c in range(STATE):
            trail[1, j, c] = trail[0, j, c]
            trail[0, j, c] = x[j, c]
    for j in range(n + 1):
        for c in range(STATE):
            x[j, c] = y[j, c]
            slope[j, c] = z[j, c]
    for k in range(actuators):
        before[2, k] = before[1, k]
        before[1, k] = before[0, k]
        before[0, k] = pressure[k]
    for j in range(samples):
        older[j] = old[j]
        old[j] = new[j]
    sample_history(x, slope, length / n, new)
    for j in range(samples):
        rate[j] = c0 * new[j] + history[j]
    return int(passes)


@leaf
def _guess(x: Array, trail: Array, ahead: bool, segments: int, y: Array) -> None:
    """Where each segment starts: the last solution, or ahead of the last three by a parabola."""
    n = x.shape[0] - 1
    for j in range(0, n, n // segments):
        for c in range(STATE):
            y[j, c] = 3.0 * (x[j, c] - trail[0, j, c]) + trail[1, j, c] if ahead else x[j, c]
