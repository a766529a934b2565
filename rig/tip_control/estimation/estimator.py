"""Extended Kalman filter of what the model does not know of the arm: strengths, damping, lag, payload and
disturbance.

measured = model tip(set-points, tau + retardation) + [static(Q, 0) - static(P, 0)]
               + (1 + softness) [static(Q, payload) - static(Q, 0)] - lag * velocity + disturbance
Q = P (1 + strength + softness)
disturbance(t) = d + sum over k of (a_k cos(2 pi k t / period) + b_k sin(2 pi k t / period))

The harmonics are the observer of a periodic reference: they have no phase lag, because they are predicted.
"""

from __future__ import annotations

import numpy as np

from model.arrays import Array
from model.inverse.static_map import LARGEST_PAYLOAD_KG, StaticMap
from rig.tip_control.estimation import tuning
from rig.tip_control.estimation.change_detection import (
    Change,
    Innovation,
    before_change,
    detected,
    matched_variance,
)
from rig.tip_control.estimation.state import (
    HARMONICS,
    DetectorState,
    EstimateLayout,
    EstimatorState,
)
from rig.tip_control.kernels.arguments import TipMap
from rig.tip_control.kernels.kalman import innovation, joseph_update
from rig.tip_control.kernels.measurement import predicted_measurement
from rig.tip_control.kernels.tip_map import map_of_payload


class TipEstimator:
    """The filter of an arm with V valves."""

    def __init__(self, static_map: StaticMap, *, learned: bool = False) -> None:
        """`learned`: the tips that it is given are without the disturbance that earlier runs have shown."""
        self._tip_map, self.layout = tip_map_of(static_map), EstimateLayout(static_map.valves)
        own = self.layout
        order = np.arange(1, HARMONICS + 1)
        self._prior_std = own.vector(
            tuning.STRENGTH_STD, tuning.SOFTNESS_STD, tuning.RETARDATION_STD_S, tuning.LAG_STD_S, tuning.PAYLOAD_STD_KG,
            tuning.OFFSET_STD_M, tuning.HARMONIC_STD_M / order,
        )  # fmt: skip
        self._first_std = (tuning.LEARNED_FACTOR if learned else 1.0) * self._prior_std
        walks = (
            tuning.STRENGTH_WALK, 0.0, tuning.RETARDATION_WALK_S, tuning.LAG_WALK_S, tuning.PAYLOAD_WALK_KG,
            tuning.OFFSET_WALK_M,
        )  # fmt: skip
        still, moving = np.zeros(HARMONICS), np.full(HARMONICS, tuning.HARMONIC_WALK_M)
        self._walk_variance = own.vector(*walks, still) ** 2
        self._periodic_walk_variance = own.vector(*walks, moving) ** 2
        self._all_move = np.ones(own.size)
        self._payload_moves = own.vector(0.0, 0.0, 0.0, 0.0, 1.0, 1.0, still)

    def start(self) -> EstimatorState:
        """The prior."""
        return EstimatorState(np.zeros(self.layout.size), np.diag(self._first_std**2))

    def predict(
        self, state: EstimatorState, motion: Array, pressure_pa: Array, time_s: float, period_s: float | None
    ) -> tuple[Array, Array]:
        """Predicted measurement (3,) and its Jacobian (3, n) by z, for the model's motion (3, 4) and pressures (V,)."""
        predicted, jacobian = predicted_measurement(
            self._tip_map, state.z, motion, pressure_pa, time_s, float(period_s or 0.0)
        )
        return predicted, jacobian

    def update(
        self, state: EstimatorState, measured_m: Array, covariance_m2: Array, prediction: tuple[Array, Array],
        passed_s: float, period_s: float | None,
    ) -> tuple[EstimatorState, float]:  # fmt: skip
        """The state after one frame, and the NIS of its innovation."""
        predicted, jacobian = prediction
        covariance = state.covariance.copy()
        # What has just changed is the payload: the frames after it show its mass, not a drift of the others.
        if not state.confirming:
            walk = self._periodic_walk_variance if period_s else self._walk_variance
            covariance.flat[:: self.layout.size + 1] += passed_s * walk
        noise = covariance_m2 + (tuning.MODEL_STD_M**2 + state.unmodelled_m2) * np.eye(3)
        gap = measured_m - predicted
        expected, nis = innovation(covariance, jacobian, noise, gap)
        state = self._adapted(state._replace(covariance=covariance), gap, expected)
        change, cusum = detected(state, Innovation(gap, jacobian, noise, nis), self.layout.payload)
        last, state = state, _counted(state)
        if change is Change.OUTLIER:
            return state._replace(detector=DetectorState(cusum, 1, state.detector.kept)), nis
        if change is Change.PAYLOAD:
            state = self._payload_changed(state)
        elif change is Change.OTHER:
            state = self._widened(state, gap)
        if change is not Change.NONE:
            gap = gap - jacobian @ (state.z - last.z)
        if state.settling:
            since_s = (tuning.SETTLING_FRAMES - state.settling) * passed_s
            noise = noise + (tuning.SWING_STD_M * np.exp(-since_s / tuning.SWING_DECAY_S)) ** 2 * np.eye(3)
        moves = self._payload_moves if state.settling else self._all_move
        z, covariance = joseph_update(state.z, state.covariance, jacobian, noise, gap, moves)
        rising = cusum > tuning.RISING
        detector = DetectorState(cusum, last.detector.rising_frames + 1 if rising else 0, last.detector.kept)
        return state._replace(
            z=z,
            covariance=covariance,
            detector=detector if rising else detector._replace(kept=(z, covariance)),
        ), nis

    def _adapted(self, state: EstimatorState, gap: Array, expected: Array) -> EstimatorState:
        """The state with the variance of what the estimates cannot follow, while it may grow."""
        if not state.adapting or state.frames > tuning.FIRST_FRAMES:
            return state
        return state._replace(unmodelled_m2=matched_variance(state.unmodelled_m2, gap, expected))

    def _payload_changed(self, state: EstimatorState) -> EstimatorState:
        """The state before the change, so that no other estimate keeps a part of it, with an unknown payload."""
        own = self.layout.payload
        z, covariance = before_change(state)
        covariance = covariance.copy()
        covariance[own, own] += tuning.CHANGE_STD_KG**2
        return state._replace(
            z=z,
            covariance=covariance,
            payload_before_kg=float(z[own]),
            settling=tuning.SETTLING_FRAMES,
            confirming=tuning.CONFIRMING_FRAMES,
        )

    def _widened(self, state: EstimatorState, gap: Array) -> EstimatorState:
        """The state that learns again: wider priors or, if that was tried just before, more measurement noise."""
        own = self.layout.payload
        z, covariance, unmodelled_m2 = state.z.copy(), state.covariance.copy(), state.unmodelled_m2
        if state.adapting:
            unmodelled_m2 += float(gap @ gap) / 3
        else:
            covariance.flat[:: self.layout.size + 1] += (tuning.WIDENING * self._prior_std) ** 2
        if state.payload_before_kg is not None:
            covariance[own, own] += (z[own] - state.payload_before_kg) ** 2
            z[own] = state.payload_before_kg
        return state._replace(
            z=z,
            covariance=covariance,
            payload_before_kg=None,
            unmodelled_m2=unmodelled_m2,
            frames=tuning.FIRST_FRAMES - tuning.REPEATED_FRAMES,
            confirming=0,
            adapting=tuning.ADAPTING_FRAMES,
        )


def _counted(state: EstimatorState) -> EstimatorState:
    """The state one frame later."""
    return state._replace(
        frames=state.frames + 1,
        settling=max(0, state.settling - 1),
        confirming=max(0, state.confirming - 1),
        adapting=max(0, state.adapting - 1),
    )


def tip_map_of(static_map: StaticMap) -> TipMap:
    """The static map as the kernels take it: with the pressures' polynomials in one index, and that without payload."""
    coefficients = np.ascontiguousarray(static_map.coefficients.reshape(-1, 3 * static_map.coefficients.shape[-2]))
    return TipMap(coefficients, map_of_payload(coefficients, 0.0), static_map.limit_pa, LARGEST_PAYLOAD_KG)
