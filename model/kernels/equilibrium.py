"""Kernels that find an arm at rest: from a guess, by following the loads up, or by letting it swing until it rests.

An equilibrium counts as found only if it is stable (model/kernels/stability.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.jit import kernel
from model.kernels.law import Walls
from model.kernels.layout import C0, LAG, LANES, LINE_DENSITY, RATE, SHEAR_INVERSE, SLOPE, STAGE, STATE, WRENCH
from model.kernels.rod import resting_wrench, strain_changes
from model.kernels.shooting import LONGEST, TOLERANCE_IN_MOTION, Workspace, newton
from model.kernels.simd import broadcast
from model.kernels.stability import is_stable
from model.kernels.time_stepping import between, copy_rows, divisor, set_pressures
from model.kernels.vec3 import called, cross, leaf, plus, put, three, triple

Array = Any

NONE = -1  # no equilibrium found
UNSTABLE = -2  # none found that is stable
SHORTEST = 1e-3  # share of the loads by which these are led up at least
SWINGS = 3  # times that an arm is let go
MOST_STEPS = 600  # of each such motion
CALM = 1e-3  # change within a step, in scaled strains and orientations, at which an arm may rest
NUDGE = 1e-4  # force that moves an arm out of an unstable equilibrium, as a share of the shear stiffness


@leaf
def uniform_guess(w: Array, walls: Walls, tip: Array, scale: Array, workspace: Workspace) -> None:
    """Fill x with the strains that the section would have everywhere if the tip's load did not turn with the arm."""
    x = workspace.x
    n = workspace.states.shape[0] - 1
    for i in range(LANES):
        for c in range(STATE):
            w[(STAGE + c) * LANES + i] = 1.0 if c in (2, 12) else 0.0
    force = three(tip, 0)
    moment = plus(plus(three(tip, 3), 1.0, cross(three(tip, 10), force)), 1.0, cross(three(tip, 16), three(tip, 13)))
    for _ in range(8):
        resting_wrench(w, walls)
        for i in range(LANES):
            put(w, RATE, i, plus(force, -1.0, triple(w, WRENCH, i)))
            put(w, RATE + 3, i, plus(moment, -1.0, triple(w, WRENCH + 3, i)))
        strain_changes(w, walls)
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


@called
def equilibrium(
    w: Array,
    walls: Walls,
    rest: Array,
    per_pressure: Array,
    free: float,
    pressure: Array,
    load: Array,
    loaded: bool,
    tip: Array,
    length: float,
    scale: Array,
    workspace: Workspace,
    tolerance: float,
) -> int:
    """Solve the static rod into workspace.x from scratch. Returns the number of passes, NONE or UNSTABLE.

    First by simple shooting from a uniform guess. Where that fails or finds an unstable equilibrium, by following the
    loads up from nothing; where the arm loses its stability on this way, by letting it swing until it rests. With
    UNSTABLE, an unstable equilibrium stands in workspace.x.
    """
    for m in range(workspace.history.shape[0]):
        workspace.history[m] = 0.0
    set_pressures(w, walls.actuators, rest, per_pressure, free, pressure)
    uniform_guess(w, walls, tip, scale, workspace)
    # One segment; a plain 1 would have numba compile Newton's method once more, for this constant. A shortened update
    # would depend on the direction in which the arm stands, and with it the equilibrium that is found.
    passes = newton(w, walls, load, loaded, tip, 0.0, length, np.int64(1), scale, workspace, tolerance, 20.0, LONGEST)
    if passes > 0 and is_stable(w, walls, workspace.x, length, tip):
        return int(passes)
    return int(
        _searched(
            w, walls, rest, per_pressure, free, pressure, load, loaded, tip, length, scale, workspace, tolerance,
            passes > 0,
        )
    )  # fmt: skip


@kernel
def _searched(
    w: Array,
    walls: Walls,
    rest: Array,
    per_pressure: Array,
    free: float,
    pressure: Array,
    load: Array,
    loaded: bool,
    tip: Array,
    length: float,
    scale: Array,
    workspace: Workspace,
    tolerance: float,
    found: bool,
) -> int:
    """What `equilibrium` does where the first guess does not suffice; found: an unstable one stands in workspace.x."""
    x = workspace.x
    unstable = x.copy()
    passes = _followed(
        w, walls, rest, per_pressure, free, pressure, load, loaded, tip, length, scale, workspace, tolerance
    )
    if passes > 0:
        return int(passes)
    set_pressures(w, walls.actuators, rest, per_pressure, free, pressure)
    passes = _relax_dynamically(w, walls, load, loaded, tip, length, scale, workspace, tolerance)
    if passes > 0:
        return int(passes)
    if not found:
        uniform_guess(w, walls, tip, scale, workspace)
        passes = newton(
            w, walls, load, loaded, tip, 0.0, length, np.int64(1), scale, workspace, tolerance, 20.0, np.inf
        )
        if passes < 0:
            return NONE
        if is_stable(w, walls, x, length, tip):
            return int(passes)
        return UNSTABLE
    copy_rows(unstable, x)
    return UNSTABLE


@kernel
def _followed(
    w: Array,
    walls: Walls,
    rest: Array,
    per_pressure: Array,
    free: float,
    pressure: Array,
    load: Array,
    loaded: bool,
    tip: Array,
    length: float,
    scale: Array,
    workspace: Workspace,
    tolerance: float,
) -> int:
    """Lead pressures and loads up from nothing, in strides as long as they end in a stable equilibrium.

    Returns the number of passes, or NONE where stability is lost on the way, with the last stable one in workspace.x.
    """
    n, x = workspace.states.shape[0] - 1, workspace.x
    # Straight, with nothing in it and nothing on it, an arm has the strains that it has at rest.
    for j in range(x.shape[0]):
        for c in range(STATE):
            x[j, c] = 1.0 if c in (2, 12) and j <= n else 0.0
    good, some, some_load, some_tip = x.copy(), np.empty_like(pressure), load.copy(), tip.copy()
    done, stride, total, segments = 0.0, 0.125, 0, divisor(n, 4)
    while done < 1.0:
        share = min(1.0, done + stride)
        for k in range(walls.actuators):
            some[k] = share * pressure[k]
        for k in range(load.shape[0]):
            some_load[k] = share * load[k]
        for k in range(6):
            some_tip[k] = share * tip[k]
        for k in range(13, 16):
            some_tip[k] = share * tip[k]
        set_pressures(w, walls.actuators, rest, per_pressure, free, some)
        passes = newton(
            w, walls, some_load, loaded, some_tip, 0.0, length, segments, scale, workspace, tolerance, 20.0,
            0.5 * LONGEST,
        )  # fmt: skip
        if passes > 0 and is_stable(w, walls, x, length, some_tip):
            total += passes
            done, stride = share, 2.0 * stride
            copy_rows(x, good)
        else:
            stride = 0.25 * min(stride, share - done)
            copy_rows(good, x)
            if stride < SHORTEST:
                return NONE
    return total


@kernel
def _relax_dynamically(
    w: Array, walls: Walls, load: Array, loaded: bool, tip: Array, length: float, scale: Array,
    workspace: Workspace, tolerance: float,
) -> int:  # fmt: skip
    """Integrate the arm in workspace.x by backward Euler under its full load until it rests in a stable equilibrium.

    Time steps of about the time that a shear wave takes along the arm damp the swing and let the arm leave an unstable
    equilibrium. Returns the number of passes of the equilibrium, or NONE.
    """
    n, x, history = workspace.states.shape[0] - 1, workspace.x, workspace.history
    size = STATE * (n + 1)
    before, some_tip, own_scale = x.copy(), tip.copy(), scale.copy()
    stiffness = 1.0 / w[SHEAR_INVERSE * LANES]
    wave_s = length * (w[LINE_DENSITY * LANES] / stiffness) ** 0.5
    lag, passes = w[LAG * LANES], NONE
    for swing in range(SWINGS):
        _stop(x)
        copy_rows(x, before)
        broadcast(w, LAG, 0.0)
        dt, steps = wave_s, 0
        while steps < MOST_STEPS:
            steps += 1
            nudged = swing > 0 and steps <= 5
            some_tip[0] = tip[0] + (NUDGE * stiffness if nudged else 0.0)
            some_tip[1] = tip[1] + (0.5 * NUDGE * stiffness if nudged else 0.0)
            c0 = 1.0 / dt
            broadcast(w, C0, c0)
            carried = max(1.0, 0.25 * c0 * length)
            for c in range(3):
                own_scale[6 + c], own_scale[9 + c] = carried * scale[c], carried * scale[3 + c]
                own_scale[22 + c], own_scale[25 + c] = 1.0 / own_scale[6 + c], 1.0 / own_scale[9 + c]
            for j in range(x.shape[0]):
                for c in range(STATE):
                    history[STATE * j + c] = -c0 * before[j, c]
            between(history, size, length / n)
            moved = newton(
                w, walls, load, loaded, some_tip, c0, length, divisor(n, max(1, int(0.5 * c0 * wave_s))),
                own_scale, workspace, TOLERANCE_IN_MOTION, 20.0, np.inf,
            )  # fmt: skip
            if moved < 0:
                copy_rows(before, x)
                dt *= 0.25
                if dt < 1e-4 * wave_s:
                    break
                continue
            _normalise(x, n)
            change = _change(x, before, scale, n)
            copy_rows(x, before)
            if change < CALM and not nudged:
                break
            if change < 0.05:
                dt = min(1.5 * dt, 20.0 * wave_s)
            elif change > 0.4:
                dt *= 0.5
        broadcast(w, C0, 0.0)
        broadcast(w, LAG, lag)
        for m in range(history.shape[0]):
            history[m] = 0.0
        _stop(x)
        copy_rows(x, before)
        passes = newton(
            w, walls, load, loaded, tip, 0.0, length, divisor(n, 4), scale, workspace, tolerance, 20.0, LONGEST
        )
        if passes > 0 and is_stable(w, walls, x, length, tip):
            return int(passes)
        if passes < 0:
            copy_rows(before, x)
    return NONE


@leaf
def _stop(x: Array) -> None:
    for j in range(x.shape[0]):
        for c in range(6, 12):
            x[j, c] = 0.0


@leaf
def _normalise(x: Array, n: int) -> None:
    for j in range(n + 1):
        over = 1.0 / (x[j, 12] ** 2 + x[j, 13] ** 2 + x[j, 14] ** 2 + x[j, 15] ** 2) ** 0.5
        for c in range(12, STATE):
            x[j, c] *= over


@leaf
def _change(x: Array, before: Array, scale: Array, n: int) -> float:
    """The largest change of strains and orientations, in units of `scale`."""
    largest = 0.0
    for j in range(n + 1):
        for c in range(STATE):
            if c < 6 or c >= 12:
                largest = max(largest, abs(x[j, c] - before[j, c]) / scale[c])
    return largest
