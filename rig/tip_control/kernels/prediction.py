"""Prediction of the tip: to the time of a frame, and over the horizon with its sensitivities (single shooting)."""

from __future__ import annotations

import numpy as np

from model.arrays import Array
from rig.tip_control.kernels.arguments import (
    FilteredState,
    ModalStep,
    ReferenceSamples,
    TimedSetPoints,
    TipMap,
    TipPrediction,
)
from rig.tip_control.kernels.compilation import compiled, internal
from rig.tip_control.kernels.interpolation import interpolate, interval_at
from rig.tip_control.kernels.measurement import disturbance, loaded_map
from rig.tip_control.kernels.modal_dynamics import modal_step, motion_step, step_matrices
from rig.tip_control.kernels.tip_map import evaluate


@compiled
def advanced(
    tip_map: TipMap, omega_rad_s: Array, tau_s: Array, motion: Array, since_s: float, until_s: float, steps: int,
    lag_s: float, samples: TimedSetPoints,
) -> tuple[Array, Array]:  # fmt: skip
    """The model's motion (3, 4) after `steps` steps between two times, and the pressures (V,) at the end.

    Under set-points that reach the chambers after a lag. With no steps the tip is at rest.
    """
    pressure, drive = np.empty(samples.pressure_pa.shape[1]), np.empty((steps + 1, 3))
    no_slopes, step_s = np.empty((0, 0)), (until_s - since_s) / max(steps, 1)
    for k in range(steps + 1):
        t_s = since_s + k * step_s if steps else until_s
        interpolate(t_s - lag_s, samples.times_s, samples.pressure_pa, pressure)
        evaluate(tip_map.nominal, pressure, tip_map.limit_pa, False, drive[k], no_slopes)
    if steps == 0:
        rest = np.zeros((3, 4))
        rest[:, 0] = drive[0]
        return rest, pressure
    transition, first, last = step_matrices(omega_rad_s, tau_s, step_s)
    modes, moved = ModalStep(transition, first, last), motion.copy()
    for k in range(steps):
        for axis in range(3):
            motion_step(modes, axis, moved[axis], drive[k, axis], drive[k + 1, axis])
    return moved, pressure


@internal
def shoot(
    tip_map: TipMap, modes: ModalStep, filtered: FilteredState, samples: TimedSetPoints, reference: ReferenceSamples,
    knots_s: Array, deviation_pa: Array, grid_s: Array, start_s: float, lag_s: float,
) -> TipPrediction:  # fmt: skip
    """The prediction at the times (K,) of a grid, which begins at the frame.

    Set-points before `start_s` are those that were commanded, later ones the feed-forward plus the deviations (k, V) at
    the knots (k,), of which the first is given and the others are free. Strengths and payload act at once, as in the
    measurement model.
    """
    z, limit_pa = filtered.z, tip_map.limit_pa
    count, valves = len(grid_s), deviation_pa.shape[1]
    free = (len(knots_s) - 1) * valves
    loaded = loaded_map(tip_map, z, valves)
    tips, sensitivities = np.empty((count, 3)), np.zeros((count, 3, free))
    pressure, strong, slopes, no_slopes = np.empty(valves), np.empty(valves), np.empty((3, valves)), np.empty((0, 0))
    drive, before, driven = np.empty(3), np.empty(3), np.empty(3)
    by, by_before = np.zeros((3, free)), np.zeros((3, free))
    moving, swinging = filtered.motion[:, :2].copy(), np.zeros((3, free, 2))
    more = np.empty(valves)
    for k in range(count):
        commanded_s = grid_s[k] - lag_s
        later = commanded_s > start_s
        by[:] = 0.0
        if later:
            interpolate(commanded_s, reference.times_s, reference.feedforward_pa, pressure)
            interpolate(commanded_s, knots_s, deviation_pa, more)
            for valve in range(valves):
                pressure[valve] += more[valve]
        else:
            interpolate(commanded_s, samples.times_s, samples.pressure_pa, pressure)
        for valve in range(valves):
            pressure[valve] = min(max(pressure[valve], 0.0), limit_pa)
            strong[valve] = pressure[valve] * (1 + z[valve] + z[valves])
        evaluate(tip_map.nominal, pressure, limit_pa, False, drive, no_slopes)
        evaluate(loaded, strong, limit_pa, later, driven, slopes)
        if later:
            left, share = interval_at(commanded_s, knots_s)
            for knot in range(max(left, 1), left + 2):
                weight = share if knot > left else 1 - share
                for axis in range(3):
                    for valve in range(valves):
                        gain = 1 + z[valve] + z[valves]
                        by[axis, (knot - 1) * valves + valve] = weight * gain * slopes[axis, valve]
        shift = disturbance(z, valves, grid_s[k], reference.period_s)
        for axis in range(3):
            if k > 0:
                moving[axis, 0], moving[axis, 1] = modal_step(
                    modes, axis, moving[axis, 0], moving[axis, 1], before[axis], drive[axis]
                )
                for j in range(free):
                    swinging[axis, j, 0], swinging[axis, j, 1] = modal_step(
                        modes, axis, swinging[axis, j, 0], swinging[axis, j, 1], by_before[axis, j], by[axis, j]
                    )
            tips[k, axis] = moving[axis, 0] - z[valves + 2] * moving[axis, 1] + driven[axis] - drive[axis] + shift[axis]
            for j in range(free):
                sensitivities[k, axis, j] = swinging[axis, j, 0] - z[valves + 2] * swinging[axis, j, 1]
            before[axis] = drive[axis]
        by, by_before = by_before, by
    return TipPrediction(grid_s, tips, sensitivities)
