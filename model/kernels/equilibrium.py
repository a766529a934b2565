"""Kernels that solve for an arm at rest: from a guess, by load continuation, or by dynamic relaxation.

Only a stable equilibrium counts as a solution (model/kernels/stability.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import ArmArguments, Fields, PressureWrench, Rod, push_of, rod_of
from model.kernels.jit import kernel
from model.kernels.lane_sums import broadcast
from model.kernels.law import Walls
from model.kernels.layout import C0, LAG, LANES, LINE_DENSITY, RATE, SHEAR_INVERSE, SLOPE, STAGE, STATE, WRENCH
from model.kernels.relaxation import interpolate_midpoints
from model.kernels.rod import resting_wrench, strain_changes
from model.kernels.shooting import LONGEST_UPDATE, TOLERANCE_IN_MOTION, Workspace, newton, workspace_within
from model.kernels.stability import is_stable
from model.kernels.time_stepping import copy_rows, divisor, set_pressures
from model.kernels.vec3 import cross, leaf, plus, put, three, triple

Array = Any

NONE = -1  # no equilibrium found
UNSTABLE = -2  # only unstable equilibria found
SMALLEST_INCREMENT = 1e-3  # of the load continuation, as a fraction of the loads
RELEASES = 3  # dynamic relaxations, each from rest
MAX_STEPS = 600  # time steps of a dynamic relaxation
RESTING_CHANGE = 1e-3  # of scaled strains and orientations within a time step, below which an arm may rest
PERTURBATION = 1e-4  # force that drives an arm out of an unstable equilibrium, as a fraction of the shear stiffness


@leaf
def uniform_guess(rod: Rod, workspace: Workspace) -> None:
    """Fill x with uniform strains of each segment that balance the loads beyond, in directions that do not turn."""
    scale, x, line, tip = rod.scale, workspace.x, rod.line, rod.ends[rod.work.shape[0] - 1]
    moment = plus(
        plus(three(tip, 3), 1.0, cross(three(tip, 10), three(tip, 0))), 1.0, cross(three(tip, 16), three(tip, 13))
    )
    force = (0.0, 0.0, 0.0)
    for s in range(rod.work.shape[0] - 1, -1, -1):
        w = rod.work[s]
        force = plus(force, 1.0, three(rod.ends[s], 0))
        for i in range(LANES):
            for c in range(STATE):
                w[(STAGE + c) * LANES + i] = 1.0 if c in (2, 12) else 0.0
        for _ in range(8):
            resting_wrench(w, rod.walls)
            for i in range(LANES):
                put(w, RATE, i, plus(force, -1.0, triple(w, WRENCH, i)))
                put(w, RATE + 3, i, plus(moment, -1.0, triple(w, WRENCH + 3, i)))
            strain_changes(w)
            largest = 0.0
            for c in range(6):
                for i in range(LANES):
                    w[(STAGE + c) * LANES + i] += w[(SLOPE + c) * LANES + i]
                largest = max(largest, abs(w[(SLOPE + c) * LANES]) / scale[c])
            if largest < 1e-6:
                break
        for c in range(STATE):
            for j in range(line.first[s], line.first[s + 1]):
                x[j, c] = w[(STAGE + c) * LANES]


@leaf
def equilibrium(rod: Rod, push: PressureWrench, pressure: Array, workspace: Workspace, tolerance: float) -> int:
    """Solve the static rod into workspace.x without a guess. Returns the number of passes, NONE or UNSTABLE.

    First by simple shooting from a uniform guess. If that fails or finds an unstable equilibrium, by load continuation;
    if the arm loses its stability on this way, by dynamic relaxation. With UNSTABLE, workspace.x holds an unstable
    equilibrium.
    """
    for m in range(workspace.history.shape[0]):
        workspace.history[m] = 0.0
    set_pressures(rod, push, pressure)
    uniform_guess(rod, workspace)
    # One segment; numba would compile Newton's method again for the constant 1. A shortened update would depend on the
    # direction of the arm in the base frame, and so would the equilibrium: a longer update is refused.
    passes = newton(rod, np.int64(1), workspace, tolerance, 20.0, LONGEST_UPDATE)
    if passes > 0 and is_stable(rod, workspace.x):
        return int(passes)
    return int(_search(rod, push, pressure, workspace, tolerance, passes > 0))


@kernel
def _search(
    rod: Rod, push: PressureWrench, pressure: Array, workspace: Workspace, tolerance: float, found: bool
) -> int:
    """The methods of `equilibrium` after the first guess; found: workspace.x holds an unstable equilibrium."""
    x = workspace.x
    unstable = x.copy()
    passes = _load_continuation(rod, push, pressure, workspace, tolerance)
    if passes > 0:
        return int(passes)
    set_pressures(rod, push, pressure)
    passes = _relax_dynamically(rod, workspace, tolerance)
    if passes > 0:
        return int(passes)
    if not found:
        uniform_guess(rod, workspace)
        passes = newton(rod, np.int64(1), workspace, tolerance, 20.0, np.inf)
        if passes < 0:
            return NONE
        if is_stable(rod, x):
            return int(passes)
        return UNSTABLE
    copy_rows(unstable, x)
    return UNSTABLE


@kernel
def _load_continuation(rod: Rod, push: PressureWrench, pressure: Array, workspace: Workspace, tolerance: float) -> int:
    """Increase pressures and loads from zero, in increments that adapt, as long as each equilibrium is stable.

    Returns the number of passes, or NONE where stability is lost, with the last stable equilibrium in workspace.x.
    """
    n, x = workspace.states.shape[0] - 1, workspace.x
    # Without pressures and loads the arm is straight and unstrained.
    for j in range(x.shape[0]):
        for c in range(STATE):
            x[j, c] = 1.0 if c in (2, 12) and j <= n else 0.0
    good, partial_pressure, partial_load, partial_ends = (
        x.copy(),
        np.empty_like(pressure),
        rod.load.copy(),
        rod.ends.copy(),
    )
    partial = Rod(rod.work, rod.walls, partial_load, rod.loaded, partial_ends, rod.length, rod.scale, rod.line)
    fraction, increment, total, segments = 0.0, 0.125, 0, divisor(n, 4)
    while fraction < 1.0:
        share = min(1.0, fraction + increment)
        for k in range(pressure.shape[0]):
            partial_pressure[k] = share * pressure[k]
        for k in range(partial_load.shape[0]):
            partial_load[k] = share * rod.load[k]
        for s in range(rod.ends.shape[0]):
            for k in range(6):
                partial_ends[s, k] = share * rod.ends[s, k]
            for k in range(13, 16):
                partial_ends[s, k] = share * rod.ends[s, k]
        set_pressures(partial, push, partial_pressure)
        passes = newton(partial, segments, workspace, tolerance, 20.0, 0.5 * LONGEST_UPDATE)
        if passes > 0 and is_stable(partial, x):
            total += passes
            fraction, increment = share, 2.0 * increment
            copy_rows(x, good)
        else:
            increment = 0.25 * min(increment, share - fraction)
            copy_rows(good, x)
            if increment < SMALLEST_INCREMENT:
                return NONE
    return total


@kernel
def _relax_dynamically(rod: Rod, workspace: Workspace, tolerance: float) -> int:
    """Integrate the arm in workspace.x by backward Euler under its full load until it rests in a stable equilibrium.

    Time steps of about the time that a shear wave takes along the arm damp the oscillation and let the arm leave an
    unstable equilibrium. Returns the number of passes of the final solution, or NONE.
    """
    length, scale, tip = rod.length, rod.scale, rod.work.shape[0] - 1
    n, x, history = workspace.states.shape[0] - 1, workspace.x, workspace.history
    size = STATE * (n + 1)
    before, moving_ends, moving_scale, lags = x.copy(), rod.ends.copy(), scale.copy(), np.empty(tip + 1)
    moving = Rod(rod.work, rod.walls, rod.load, rod.loaded, moving_ends, length, moving_scale, rod.line)
    stiffness, wave_s, passes = 1.0 / rod.work[tip, SHEAR_INVERSE * LANES], 0.0, NONE
    for k in range(tip + 1):
        w = rod.work[k]
        own = rod.line.step[k] * (rod.line.first[k + 1] - 1 - rod.line.first[k])
        wave_s += own * (w[LINE_DENSITY * LANES] * w[SHEAR_INVERSE * LANES]) ** 0.5
        lags[k] = w[LAG * LANES]
    for release in range(RELEASES):
        _zero_velocities(x)
        copy_rows(x, before)
        for k in range(tip + 1):
            broadcast(rod.work[k], LAG, 0.0)
        dt, steps = wave_s, 0
        while steps < MAX_STEPS:
            steps += 1
            perturbed = release > 0 and steps <= 5
            moving_ends[tip, 0] = rod.ends[tip, 0] + (PERTURBATION * stiffness if perturbed else 0.0)
            moving_ends[tip, 1] = rod.ends[tip, 1] + (0.5 * PERTURBATION * stiffness if perturbed else 0.0)
            c0 = 1.0 / dt
            for k in range(tip + 1):
                broadcast(rod.work[k], C0, c0)
            carried = max(1.0, 0.25 * c0 * length)
            for c in range(3):
                moving_scale[6 + c], moving_scale[9 + c] = carried * scale[c], carried * scale[3 + c]
                moving_scale[22 + c], moving_scale[25 + c] = 1.0 / moving_scale[6 + c], 1.0 / moving_scale[9 + c]
            for j in range(x.shape[0]):
                for c in range(STATE):
                    history[STATE * j + c] = -c0 * before[j, c]
            interpolate_midpoints(history, size, rod.line)
            segments = divisor(n, max(1, int(0.5 * c0 * wave_s)))
            moved = newton(moving, segments, workspace, TOLERANCE_IN_MOTION, 20.0, np.inf)
            if moved < 0:
                copy_rows(before, x)
                dt *= 0.25
                if dt < 1e-4 * wave_s:
                    break
                continue
            _normalise(x, n)
            change = _largest_change(x, before, scale, n)
            copy_rows(x, before)
            if change < RESTING_CHANGE and not perturbed:
                break
            if change < 0.05:
                dt = min(1.5 * dt, 20.0 * wave_s)
            elif change > 0.4:
                dt *= 0.5
        for k in range(tip + 1):
            broadcast(rod.work[k], C0, 0.0)
            broadcast(rod.work[k], LAG, lags[k])
        for m in range(history.shape[0]):
            history[m] = 0.0
        _zero_velocities(x)
        copy_rows(x, before)
        passes = newton(rod, divisor(n, 4), workspace, tolerance, 20.0, LONGEST_UPDATE)
        if passes > 0 and is_stable(rod, x):
            return int(passes)
        if passes < 0:
            copy_rows(before, x)
    return NONE


@leaf
def _zero_velocities(x: Array) -> None:
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
def _largest_change(x: Array, before: Array, scale: Array, n: int) -> float:
    """The largest change of strains and orientations, in units of `scale`."""
    largest = 0.0
    for j in range(n + 1):
        for c in range(STATE):
            if c < 6 or c >= 12:
                largest = max(largest, abs(x[j, c] - before[j, c]) / scale[c])
    return largest


@kernel
def solve_equilibrium(walls: Walls, arm_fields: Fields, pressure: Array, pool: Array, tolerance: float) -> int:
    """Solve as `equilibrium` for one arm under pressures (N,) [Pa], into the workspace of a pool."""
    arm = ArmArguments(*arm_fields)
    workspace = workspace_within(pool, arm.load.shape[0] // 12, 0)
    return int(equilibrium(rod_of(arm, walls, arm.ends), push_of(arm, 0), pressure, workspace, tolerance))
