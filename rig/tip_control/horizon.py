"""Horizon control: the set-points of the next frames from a quadratic program.

The tip over the horizon is linearised about the last plan (one Gauss-Newton step per frame). The unknowns are the
deviations from the feed-forward at a few times, linear in between (blocked moves).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from model.inverse.static_map import StaticMap
from rig.tip_control.estimator import EstimatorState, TipEstimator
from rig.tip_control.interface import (
    ControllerMeasurement,
    PayloadEstimate,
    ReferenceTrajectory,
    SetPointPlan,
    SolveStatus,
    TipControlSettings,
)
from rig.tip_control.tip_dynamics import TipDynamics
from runs.interpolation import interpolated

Array = NDArray[np.float64]

HORIZON = 15
"""Frames of the horizon."""
KNOTS = (0, 1, 2, 4, 8, 15)
"""Frames from the start of the plan at which the deviation is a variable; at the first one it is given."""
STEPS_PER_FRAME = 2
SETTLING_WEIGHT = 0.04
"""Cost of a deviation's rate of 1 bar/s, as a tip error [mm] that costs the same."""
MOST_ITERATIONS = 200
_PA_PER_BAR = 1e5
_MM = 1e3
_SOLVED = (1, 2)
"""Exit flags of DAQP: optimal, and optimal with soft constraints violated."""
_SOFT = 8
_LONGEST_GAP_S = 0.5


class HorizonState(NamedTuple):
    """The model's tip and velocity (2, 3) at the last frame, its time, the estimator, and the last plan."""

    tip: Array | None
    time_s: float
    estimator: EstimatorState
    times_s: Array
    setpoint_pa: Array


class _Prediction(NamedTuple):
    """Tips (K, 3) at the times (K,) of a grid, and their slopes (3, K, n) by the n free deviations [m/Pa]."""

    grid_s: Array
    tips_m: Array
    slopes: Array

    def moved(self, change_pa: Array) -> Array:
        """The tips (K, 3) after a change (n,) of the free deviations."""
        moved: Array = self.tips_m + (self.slopes @ change_pa).T
        return moved


class _Program(NamedTuple):
    """What is the same in the quadratic program of every frame: the interpolation of the deviations, and its rates.

    `blocks` (HORIZON + 1, k): weights of the deviations at the frames. `rows` (m, n): constraints of the free ones.
    `rates` (r, n): rates of change of the free deviations, times the root of their cost; `first_rates` (r, V): those of
    the given deviation.
    """

    blocks: Array
    rows: Array
    rates: Array
    first_rates: Array

    @classmethod
    def of(cls, valves: int, frame_s: float) -> _Program:
        knots = np.array(KNOTS, dtype=np.float64)
        blocks = _hat(np.arange(HORIZON + 1, dtype=np.float64), knots)
        changes = np.diff(np.eye(len(KNOTS)), axis=0) / (frame_s * np.diff(knots)[:, None])
        costly: Array = SETTLING_WEIGHT * np.asarray(np.kron(changes, np.eye(valves)), np.float64)
        free = np.concatenate([blocks[1:, 1:], np.diff(blocks[:, 1:], axis=0)])
        return cls(blocks, np.kron(free, np.eye(valves)), costly[:, valves:], costly[:, :valves])


class HorizonControl:
    """EKF, periodic observer and a quadratic program over the horizon."""

    def __init__(self, settings: TipControlSettings) -> None:
        self._settings = settings
        self._map = StaticMap.of(settings.arm, settings.valve_of, settings.pressure_limit_pa)
        self._dynamics = TipDynamics.of(settings.arm, settings.pressure_limit_pa)
        self._estimator = TipEstimator(self._map, learned=settings.learned)
        self._step_s = settings.frame_s / STEPS_PER_FRAME
        self._program = _Program.of(self._map.valves, settings.frame_s)

    def start(self) -> HorizonState:
        """Nothing is known."""
        return HorizonState(None, math.nan, self._estimator.start(), np.empty(0), np.empty((0, self._map.valves)))

    def step(self, state: Any, reference: ReferenceTrajectory, measurement: ControllerMeasurement) -> SetPointPlan:
        """Correct the estimates by the frame, predict past the delays, and solve for the plan."""
        state, nis = self._observed(state, reference.period_s, measurement)
        return self._planned(state, reference, measurement, self._estimator.estimate(state.estimator, nis))

    def _observed(
        self, state: HorizonState, period_s: float | None, measurement: ControllerMeasurement
    ) -> tuple[HorizonState, float]:
        """The state at the time of the frame, and the NIS."""
        lag_s, passed_s = self._settings.pressure_lag_s, measurement.time_s - state.time_s
        if state.tip is None or not 0 < passed_s < _LONGEST_GAP_S:
            pressure = interpolated(measurement.time_s - lag_s, measurement.sample_s, measurement.setpoint_pa)
            tip = np.stack([self._map.tips(pressure[None])[0], np.zeros(3)])
            passed_s = 0.0
        else:
            steps = max(1, round(passed_s / self._step_s))
            times = state.time_s + passed_s / steps * np.arange(steps + 1, dtype=np.float64) - lag_s
            drive = self._map.tips(interpolated(times, measurement.sample_s, measurement.setpoint_pa))
            tip = self._dynamics.advance(state.tip, drive, passed_s / steps)[-1]
            pressure = interpolated(times[-1], measurement.sample_s, measurement.setpoint_pa)
        estimator, nis = state.estimator, math.nan
        if np.isfinite(measurement.tip_m).all():
            prediction = self._estimator.predict(estimator, tip[0], tip[1], pressure, measurement.time_s, period_s)
            estimator, nis = self._estimator.update(
                estimator, measurement.tip_m, measurement.covariance_m2, prediction, passed_s, period_s
            )
        return state._replace(tip=tip, time_s=measurement.time_s, estimator=estimator), nis

    def _planned(
        self,
        state: HorizonState,
        reference: ReferenceTrajectory,
        measurement: ControllerMeasurement,
        estimate: PayloadEstimate,
    ) -> SetPointPlan:
        """The plan from the start on: one Gauss-Newton step about the last plan."""
        start_s, frame_s = measurement.start_s, self._settings.frame_s
        knots_s = start_s + frame_s * np.array(KNOTS, dtype=np.float64)
        frames_s = start_s + frame_s * np.arange(HORIZON + 1, dtype=np.float64)
        feed = interpolated(frames_s, reference.times_s, reference.feedforward_pa)
        deviation = _last_deviation(state, reference, knots_s, measurement.setpoint_pa[-1], feed[0])
        before = deviation[1:].reshape(-1) / _PA_PER_BAR
        prediction = self._prediction(state, reference, measurement, knots_s, deviation, frames_s[-1])
        hessian, slope = self._cost(prediction, reference, frames_s, deviation[0], before)
        low, high = self._bounds(feed, deviation[0])
        found, _, flag, info = daqp.solve(
            hessian, slope, self._program.rows, high, low,
            np.full(len(low), _SOFT, dtype=np.int32), iter_limit=MOST_ITERATIONS,
        )  # fmt: skip
        solved = flag in _SOLVED and bool(np.isfinite(found).all())
        change = np.zeros(len(before))
        if solved:
            change = _PA_PER_BAR * (np.asarray(found) - before)
            deviation[1:] += change.reshape(deviation[1:].shape)
        times = start_s + self._step_s * np.arange(HORIZON * STEPS_PER_FRAME + 1, dtype=np.float64)
        setpoint = interpolated(times, reference.times_s, reference.feedforward_pa)
        setpoint += interpolated(times, knots_s, deviation)
        setpoint = np.clip(setpoint, 0.0, self._settings.pressure_limit_pa)  # the constraints are soft
        return SetPointPlan(
            times, setpoint, interpolated(times, prediction.grid_s, prediction.moved(change)),
            state._replace(times_s=times, setpoint_pa=setpoint),
            SolveStatus.SOLVED if solved else SolveStatus.NOT_SOLVED,
            int(info["iterations"]), int(np.count_nonzero(info["lam"])), estimate,
        )  # fmt: skip

    def _prediction(
        self,
        state: HorizonState,
        reference: ReferenceTrajectory,
        measurement: ControllerMeasurement,
        knots_s: Array,
        deviation: Array,
        stop_s: float,
    ) -> _Prediction:
        """The tips from the last frame to the end of the horizon under the last plan, and how they answer."""
        start_s, known = measurement.start_s, state.estimator
        count = 1 + math.ceil((stop_s - state.time_s) / self._step_s)
        grid_s = np.arange(count, dtype=np.float64) * self._step_s + state.time_s
        asked_s, lag_s = grid_s - self._settings.pressure_lag_s, self._estimator.lag_s(known)
        weights = _hat(asked_s, knots_s)
        past = interpolated(asked_s, measurement.sample_s, measurement.setpoint_pa)
        future = interpolated(asked_s, reference.times_s, reference.feedforward_pa) + weights @ deviation
        later = (asked_s > start_s)[:, None]
        pressure = np.clip(np.where(later, future, past), 0.0, self._settings.pressure_limit_pa)
        nominal = self._map.tips(pressure)
        drive, by_pressure = self._estimator.drive(known, pressure)
        moving = state.tip if state.tip is not None else np.stack([nominal[0], np.zeros(3)])
        responses = self._dynamics.responses(count - 1, self._step_s)
        # As the estimator predicts measurements: strengths and payload act at once.
        response = responses.tip - lag_s * responses.velocity
        free = responses.free[:, :, 0] - lag_s * responses.free[:, :, 1]
        tips = (free @ moving.T[:, :, None] + response @ nominal.T[:, :, None])[:, :, 0].T + drive - nominal
        tips += self._estimator.disturbance(known, grid_s, reference.period_s)
        weights = np.where(later, weights, 0.0)[:, 1:]
        by_deviation = weights[None, :, :, None] * by_pressure.transpose(1, 0, 2)[:, :, None]
        return _Prediction(grid_s, tips, response @ by_deviation.reshape(3, count, -1))

    def _cost(
        self, prediction: _Prediction, reference: ReferenceTrajectory, frames_s: Array, first: Array, before: Array
    ) -> tuple[Array, Array]:
        """Hessian (n, n) and slope (n,) of the cost by the deviations [bar] at all knots but the first.

        `first` (V,) is the given deviation [Pa], `before` (n,) are the others of the last plan [bar].
        """
        rates, first_rates = self._program.rates, self._program.first_rates
        row = (frames_s[1:] - prediction.grid_s[0]) / self._step_s
        left = np.minimum(row.astype(np.int64), len(prediction.grid_s) - 2)
        share = (row - left)[:, None]
        tips, slopes = prediction.tips_m, prediction.slopes
        seen = (1 - share) * tips[left] + share * tips[left + 1]
        matrix = ((1 - share) * slopes[:, left] + share * slopes[:, left + 1]).reshape(-1, len(before))
        gap = (interpolated(frames_s[1:], reference.times_s, reference.position_m) - seen).T.reshape(-1)
        used = np.isfinite(gap)
        matrix, gap = _MM * _PA_PER_BAR * matrix[used], _MM * gap[used]
        gap = gap + matrix @ before
        rate_gap = -(first_rates @ first) / _PA_PER_BAR
        return matrix.T @ matrix + rates.T @ rates, -(matrix.T @ gap + rates.T @ rate_gap)

    def _bounds(self, feed: Array, first: Array) -> tuple[Array, Array]:
        """Bounds (m,) [bar] of pressure and rate at each frame; `first` (V,) is the given deviation [Pa]."""
        limit, room = self._settings.pressure_limit_pa, self._settings.rate_limit_pa_s * self._settings.frame_s
        base = feed + self._program.blocks[:, :1] * first
        levels, steps = base[1:], np.diff(base, axis=0)
        low = np.concatenate([-levels, -room - steps])
        high = np.concatenate([limit - levels, room - steps])
        return low.reshape(-1) / _PA_PER_BAR, high.reshape(-1) / _PA_PER_BAR


def _last_deviation(
    state: HorizonState, reference: ReferenceTrajectory, knots_s: Array, now_pa: Array, feed_pa: Array
) -> Array:
    """Deviations (k, V) of the last plan from the feed-forward at the new knots, from where the set-points are."""
    if len(state.times_s):
        last = interpolated(knots_s, state.times_s, state.setpoint_pa)
        deviation = last - interpolated(knots_s, reference.times_s, reference.feedforward_pa)
    else:
        deviation = np.tile(now_pa - feed_pa, (len(KNOTS), 1))
    deviation[0] = now_pa - feed_pa
    return deviation


def _hat(times_s: Array, at_s: Array) -> Array:
    """Weights (K, n) of values at times (n,) in their linear interpolation at times (K,)."""
    return interpolated(times_s, at_s, np.eye(len(at_s)))
