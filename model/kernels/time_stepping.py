"""Kernels of the time steps of an arm in motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.arguments import Fields, Line, MotionState, PressureWrench, Rod
from model.kernels.jit import kernel
from model.kernels.law import branched
from model.kernels.layout import ALL_TRIOS, LANES, OFFSET, PER_TUBE, STATE, TRIO
from model.kernels.relaxation import compute_past_strains, interpolate_midpoints, relax_branches
from model.kernels.shooting import Workspace, newton
from model.kernels.vec3 import called, inlined, leaf

Array = Any


@leaf
def set_pressures(rod: Rod, push: PressureWrench, pressure: Array) -> None:
    """Write the wrench and free strains of the pressures (A,) [Pa] into all lanes."""
    first = TRIO if rod.walls.tubes <= 3 else ALL_TRIOS
    for s in range(rod.work.shape[0]):
        w, begin, end = rod.work[s], push.chambers[s], push.chambers[s + 1]
        for c in range(6):
            total = push.rest[s, c]
            for k in range(begin, end):
                total += push.per_pressure[s, c, k] * pressure[k]
            for i in range(LANES):
                w[(OFFSET + c) * LANES + i] = total
        for k in range(begin, end):
            for i in range(LANES):
                w[(first + PER_TUBE * (k - begin) + 2) * LANES + i] = push.free_per_pa[s] * pressure[k]


@leaf
def copy_rows(a: Array, b: Array) -> None:
    """Copy rows of a to b. An assignment of whole arrays would compile code that formats errors."""
    for j in range(a.shape[0]):
        for c in range(STATE):
            b[j, c] = a[j, c]


@kernel
def _continuation(
    rod: Rod, push: PressureWrench, last: Array, pressure: Array, segments: int, workspace: Workspace, tolerance: float
) -> int:
    """Change the pressures from the last ones to the new ones in increments that adapt (continuation)."""
    x = workspace.x
    good, partial_pressure = x.copy(), np.empty_like(pressure)
    fraction, increment, total = 0.0, 0.125, 0
    while fraction < 1.0:
        share = min(1.0, fraction + increment)
        for k in range(pressure.shape[0]):
            partial_pressure[k] = last[k] + (pressure[k] - last[k]) * share
        set_pressures(rod, push, partial_pressure)
        passes = newton(rod, segments, workspace, tolerance, 40.0, np.inf)
        if passes > 0:
            total += passes
            fraction, increment = share, 2.0 * increment
            copy_rows(x, good)
        else:
            increment *= 0.25
            copy_rows(good, x)
            if increment < 1e-3:
                return -1
    return total


@leaf
def divisor(n: int, wanted: int) -> int:
    """The smallest divisor of n that is at least `wanted`."""
    for d in range(max(1, wanted), n + 1):
        if n % d == 0:
            return d
    return n


@called
def initialise_history(scheme: Array, x: Array, past_states: Array, line_fields: Fields, workspace: Workspace) -> None:
    """Fill past_states and workspace.history for the first time step of an arm that has long been at rest in x."""
    history, share = workspace.history, scheme[1] + scheme[2] + scheme[3]
    flat, past = x.reshape(x.size), past_states.reshape(2, x.size)
    for m in range(x.size):
        history[m] = share * flat[m]
        past[0, m] = flat[m]
        past[1, m] = flat[m]
    interpolate_midpoints(history, x.size // 2, Line(*line_fields))


@inlined
def _update_history(scheme: Array, y: Array, x: Array, past_states: Array, history: Array) -> None:
    """Compute the history y^h (eq 26) for the next time step after a step to y, and shift the past solutions by one."""
    c0, c1, c2, c3, d1 = scheme[0], scheme[1], scheme[2], scheme[3], scheme[4]
    now, last, past = y.reshape(y.size), x.reshape(y.size), past_states.reshape(2, y.size)
    for m in range(now.size):
        rate = c0 * now[m] + history[m]
        history[m] = c1 * now[m] + c2 * last[m] + c3 * past[0, m] + d1 * rate
        past[1, m] = past[0, m]
        past[0, m] = last[m]
        last[m] = now[m]


@inlined
def advance(
    rod: Rod, push: PressureWrench, state: MotionState, pressure: Array, workspace: Workspace, tolerance: float
) -> int:
    """Solve one time step. Returns the number of passes, or -1: then only work array and workspace are changed.

    pressure (N,) [Pa]: at the end of the step. The guess is extrapolated if extrapolation also
    predicts the new pressures better than the last ones do. workspace.history: y^h at the nodes, its derivatives, and
    the same at the mid-points, (N + 1) x 16 each; workspace.walls_past: likewise of the past strains of the walls,
    which differ with Maxwell branches (`relaxation`). If Newton's method fails, it is repeated with more segments,
    then with continuation in the pressures.
    """
    n = workspace.states.shape[0] - 1
    x, past_states, last_pressures, segments = state.x, state.past_states, state.last_pressures, state.segments
    y, actuators = workspace.x, pressure.shape[0]
    set_pressures(rod, push, pressure)
    extrapolate, off = 0.0, 0.0
    for k in range(actuators):
        off += abs(pressure[k] - last_pressures[0, k])
        extrapolate += abs(pressure[k] - 3.0 * (last_pressures[0, k] - last_pressures[1, k]) - last_pressures[2, k])
    _predict(x, past_states, extrapolate <= off, n, segments, y)
    passes = newton(rod, segments, workspace, tolerance, 8.0, np.inf)
    if passes < 0:
        finer = divisor(n, max(4, 2 * segments))
        _predict(x, past_states, False, n, finer, y)
        passes = newton(rod, finer, workspace, tolerance, 25.0, np.inf)
        if passes < 0:
            _predict(x, past_states, False, n, finer, y)
            passes = _continuation(rod, push, last_pressures[0], pressure, finer, workspace, tolerance)
            if passes < 0:
                return -1
    for j in range(n + 1):
        over = 1.0 / (y[j, 12] ** 2 + y[j, 13] ** 2 + y[j, 14] ** 2 + y[j, 15] ** 2) ** 0.5
        for c in range(12, 16):
            y[j, c] *= over
    for k in range(actuators):
        last_pressures[2, k] = last_pressures[1, k]
        last_pressures[1, k] = last_pressures[0, k]
        last_pressures[0, k] = pressure[k]
    if branched(rod.walls.law):
        relax_branches(rod.line, state.branch_factors, state.branch_strains, y, x)
    _update_history(state.coefficients, y, x, past_states, workspace.history)
    interpolate_midpoints(workspace.history, x.size // 2, rod.line)
    if branched(rod.walls.law):
        compute_past_strains(
            rod.line, state.branch_factors, state.branch_strains, x, workspace.history, workspace.walls_past
        )
        interpolate_midpoints(workspace.walls_past, x.size // 2, rod.line)
    return int(passes)


@leaf
def _predict(x: Array, past_states: Array, extrapolate: bool, n: int, segments: int, y: Array) -> None:
    """Guess the state at the start of each segment: the last solution, or the parabola through the last three."""
    for j in range(0, n, n // segments):
        for c in range(STATE):
            y[j, c] = 3.0 * (x[j, c] - past_states[0, j, c]) + past_states[1, j, c] if extrapolate else x[j, c]
