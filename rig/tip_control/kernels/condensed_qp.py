"""The quadratic program of one Gauss-Newton step: the states are eliminated (condensing), the moves are blocked.

The unknowns (n,) are the deviations [bar] from the feed-forward of V valves at all knots but the first; rows of frames
have the valves as the fastest index. In mm and bar.
"""

from __future__ import annotations

import numpy as np

from model.arrays import Array
from model.units import MM_PER_M, PA_PER_BAR
from rig.tip_control.kernels.arguments import (
    FilteredState,
    ModalStep,
    QuadraticProgram,
    ReferenceSamples,
    TimedSetPoints,
    TipMap,
    TipPrediction,
)
from rig.tip_control.kernels.compilation import compiled
from rig.tip_control.kernels.interpolation import interpolate, interval_at
from rig.tip_control.kernels.prediction import shoot
from rig.tip_control.move_blocking import MoveBlocking


@compiled
def gauss_newton_program(
    tip_map: TipMap, modes: ModalStep, filtered: FilteredState, samples: TimedSetPoints, reference: ReferenceSamples,
    last_plan: TimedSetPoints, blocking: MoveBlocking, start_s: float, step_s: float, lag_s: float, change_pa: float,
) -> QuadraticProgram:  # fmt: skip
    """The program of a plan from `start_s` on, linearised about the last plan, which is empty before the first.

    It begins with the newest set-points. `step_s`: grid of the prediction; `lag_s`: from set-points to pressures;
    `change_pa`: largest change between two frames. A free coordinate of the reference has no part in the cost.
    """
    now_pa, feed_pa = samples.pressure_pa[len(samples.times_s) - 1], reference.feedforward_pa
    knots_s, frames_s = start_s + blocking.knots_s, start_s + blocking.frames_s
    valves, knots, frames = feed_pa.shape[1], len(knots_s), len(frames_s)
    feed, deviation = np.empty((frames, valves)), np.empty((knots, valves))
    for k in range(frames):
        interpolate(frames_s[k], reference.times_s, feed_pa, feed[k])
    planned, there = np.empty(valves), np.empty(valves)
    for knot in range(knots):
        if knot and len(last_plan.times_s):
            interpolate(knots_s[knot], last_plan.times_s, last_plan.pressure_pa, planned)
            interpolate(knots_s[knot], reference.times_s, feed_pa, there)
            deviation[knot] = planned - there
        else:
            deviation[knot] = now_pa - feed[0]
    count = int(np.ceil((frames_s[frames - 1] - filtered.time_s) / step_s)) + 1
    grid_s = filtered.time_s + step_s * np.arange(count)
    prediction = shoot(
        tip_map, modes, filtered, samples, reference, knots_s, deviation, grid_s, start_s, lag_s
    )  # fmt: skip
    tips, sensitivities = prediction.tips_m, prediction.sensitivities
    free = (knots - 1) * valves
    hessian, gradient, row, wanted = blocking.rate_hessian.copy(), np.zeros(free), np.empty(free), np.empty(3)
    before = deviation[1:].copy().reshape(free) / PA_PER_BAR
    for k in range(free):
        for valve in range(valves):
            gradient[k] += blocking.rate_gradient[k, valve] * deviation[0, valve] / PA_PER_BAR
    for k in range(1, frames):
        interpolate(frames_s[k], reference.times_s, reference.position_m, wanted)
        left, share = interval_at(frames_s[k], grid_s)
        for axis in range(3):
            if not np.isfinite(wanted[axis]):
                continue
            tip = (1 - share) * tips[left, axis] + share * tips[left + 1, axis]
            gap = MM_PER_M * (wanted[axis] - tip)
            for j in range(free):
                slope = (1 - share) * sensitivities[left, axis, j] + share * sensitivities[left + 1, axis, j]
                row[j] = MM_PER_M * PA_PER_BAR * slope
            for j in range(free):
                gap += row[j] * before[j]
            for i in range(free):
                gradient[i] -= gap * row[i]
                for j in range(free):
                    hessian[i, j] += row[i] * row[j]
    half = (frames - 1) * valves
    lowest, highest = np.empty(2 * half), np.empty(2 * half)
    for k in range(1, frames):
        for valve in range(valves):
            level = feed[k, valve] + blocking.first_weights[k] * deviation[0, valve]
            rise = level - feed[k - 1, valve] - blocking.first_weights[k - 1] * deviation[0, valve]
            place = (k - 1) * valves + valve
            lowest[place], highest[place] = -level / PA_PER_BAR, (tip_map.limit_pa - level) / PA_PER_BAR
            lowest[half + place] = (-change_pa - rise) / PA_PER_BAR
            highest[half + place] = (change_pa - rise) / PA_PER_BAR
    return QuadraticProgram(hessian, gradient, lowest, highest, deviation, prediction)


@compiled
def plan_of(
    times_s: Array, limit_pa: float, solution_bar: Array, reference: ReferenceSamples, knots_s: Array,
    deviation_pa: Array, prediction: TipPrediction,
) -> tuple[Array, Array]:  # fmt: skip
    """Set-points (p, V) [Pa] and predicted tips (p, 3) [m] at times (p,) of a solution (n,) of the program.

    Set-points are kept within the pressure limit: the constraints of the program are soft.
    """
    knots, valves = deviation_pa.shape
    deviation, change = deviation_pa.copy(), np.empty(len(solution_bar))
    for knot in range(1, knots):
        for valve in range(valves):
            place = (knot - 1) * valves + valve
            deviation[knot, valve] = solution_bar[place] * PA_PER_BAR
            change[place] = deviation[knot, valve] - deviation_pa[knot, valve]
    moved = prediction.tips_m.copy()
    for k in range(moved.shape[0]):
        for axis in range(3):
            for j in range(len(change)):
                moved[k, axis] += prediction.sensitivities[k, axis, j] * change[j]
    setpoint, predicted, more = np.empty((len(times_s), valves)), np.empty((len(times_s), 3)), np.empty(valves)
    for k in range(len(times_s)):
        interpolate(times_s[k], reference.times_s, reference.feedforward_pa, setpoint[k])
        interpolate(times_s[k], knots_s, deviation, more)
        for valve in range(valves):
            setpoint[k, valve] = min(max(setpoint[k, valve] + more[valve], 0.0), limit_pa)
        interpolate(times_s[k], prediction.times_s, moved, predicted[k])
    return setpoint, predicted
