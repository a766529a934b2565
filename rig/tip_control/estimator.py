"""Extended Kalman filter of what the model does not know of the arm: strengths, lag, payload and disturbance.

measured = model tip(set-points) + [static(Q, 0) - static(P, 0)] + (1 + softness) [static(Q, payload) - static(Q, 0)]
               - lag * velocity + disturbance                             with Q = P (1 + gain + softness)
disturbance(t) = d + sum over k of (a_k cos(2 pi k t / period) + b_k sin(2 pi k t / period))

The harmonics are the observer of a periodic reference: they have no phase lag, because they are predicted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.inverse.static_map import LARGEST_PAYLOAD_KG, StaticMap
from rig.tip_control.interface import PayloadEstimate

Array = NDArray[np.float64]

HARMONICS = 4
GAIN_STD, GAIN_WALK = 0.05, 5e-4
"""Prior standard deviation of a valve's strength, and its random walk per square root of a second."""
SOFTNESS_STD = 0.04
"""A soft arm yields to all valves and to a payload alike."""
LAG_STD_S, LAG_WALK_S = 0.01, 2e-4
PAYLOAD_STD_KG, PAYLOAD_WALK_KG = 0.003, 2e-4
OFFSET_STD_M, OFFSET_WALK_M = 3e-4, 3e-5
HARMONIC_STD_M, HARMONIC_WALK_M = 3e-4, 1.5e-5
LEARNED_SHARE = 0.1
"""Share of the prior standard deviations that is left when earlier runs have shown the disturbance."""
MODEL_STD_M = 1.2e-4
"""White error of the model beside that of the measurement."""
OUTLIER_NIS = 20.0
"""One frame of a larger NIS (three degrees of freedom) is not used: it may be a wrong measurement."""
USUAL_NIS = 8.0
"""The sum over the frames of the NIS beyond this, each at most OUTLIER_NIS, shows a change of the payload."""
CHANGE_NIS = 22.0
"""Such a sum means that something was hung on the tip; with a consistent filter once in an hour."""
SUSPICION_NIS = 1.0
"""The estimates before the sum has passed this are kept, and a change of the payload is estimated from them on."""
LEARNING_FRAMES = 90
"""Frames after the start in which a large NIS means nothing: the estimates are still far off."""
LEARNING_AGAIN_FRAMES = 45
"""The same after everything is learned again."""
JUMP_KG = 0.15
SWING_M, SWING_S = 2e-3, 0.1
"""The arm swings after a change: standard deviation at its start, and the time in which it decays."""
SETTLING_FRAMES = 12
"""Frames after a change in which only payload and offset are estimated."""
RELAPSE_FRAMES = 90
"""A second change within so many frames: it is not a payload, but an arm beyond the priors."""
EXPLAINED_SHARE, REST_NIS = 0.89, 4.6
"""A payload explains this share of the NIS, or leaves less than this: 90 % of the chi-squared of two degrees."""
SUDDEN_FRAMES, SUDDEN_SHARE = 2, 0.75
"""The share for a sum that has risen within so few frames: the arm still swings towards where the payload pulls it."""
ANSWER_STD = 0.08
"""Share by which an arm with hysteresis and creep answers a change of its load otherwise than the estimates say."""
UNMODELLED_FRAMES = 300
"""A difference that is back within so many frames of learning again is not learned: it counts as noise."""
TOLERATED, UNMODELLED_SHARE = 1.5, 1 / 8
"""Mean square of the innovations, relative to the expected one, above which the noise grows while everything is learned
again, and the share by which one frame corrects it."""
BEYOND_PRIORS = 3.0
"""The prior standard deviations are multiplied by this for an arm beyond them, and everything is learned again."""


class PayloadClone(NamedTuple):
    """The payload [kg] before a change, its variance, and its covariance (n,) with the estimates (a cloned state)."""

    payload_kg: float
    variance: float
    covariance: Array


class EstimatorState(NamedTuple):
    """Estimates `z` (n,) with covariance (n, n), and the number of frames.

    `excess`: sum of the NIS beyond USUAL_NIS. `frames`: since everything is learned. `settling`: frames until the arm
    has settled after a change. `relapse`: frames in which a second change is not taken for a payload.
    `suspected`: frames since `excess` began to rise, `calm`: z and covariance before that.
    `before`: the payload before the last change, None without any. `unmodelled_m2`: variance of each coordinate by what
    learning does not take away, as of a motion too fast for the model; `again`: frames in which it may grow.
    z: gains (V,), softness, lag, payload, offset (3,), then a_k and b_k (3,) of each harmonic.
    """

    z: Array
    covariance: Array
    excess: float = 0.0
    frames: int = 0
    settling: int = 0
    relapse: int = 0
    suspected: int = 0
    calm: tuple[Array, Array] | None = None
    before: PayloadClone | None = None
    unmodelled_m2: float = 0.0
    again: int = 0


class TipEstimator:
    """The filter of an arm with V valves."""

    def __init__(self, static_map: StaticMap, *, learned: bool = False) -> None:
        """`learned`: the tips that it is given are without the disturbance that earlier runs have shown."""
        self._map, self._unknown = static_map, LEARNED_SHARE if learned else 1.0
        valves = self._valves = static_map.valves
        self._soft, self._lag, self._payload, self._offset, self._waves = valves + np.array([0, 1, 2, 3, 6])
        self._size = self._waves + 6 * HARMONICS

    def start(self) -> EstimatorState:
        """The prior."""
        return EstimatorState(np.zeros(self._size), np.diag((self._unknown * self._prior_std()) ** 2))

    def gains(self, state: EstimatorState) -> Array:
        """Relative strength (V,) of each valve's actuators beyond the model's."""
        gains: Array = state.z[: self._valves] + state.z[self._soft]
        return gains

    def lag_s(self, state: EstimatorState) -> float:
        """Lag of the tip beyond the model's [s]."""
        return float(state.z[self._lag])

    def payload_kg(self, state: EstimatorState) -> float:
        """Payload beyond the model's cap [kg]."""
        return float(np.clip(state.z[self._payload], -LARGEST_PAYLOAD_KG, LARGEST_PAYLOAD_KG))

    def estimate(self, state: EstimatorState, nis: float) -> PayloadEstimate:
        """What is recorded."""
        payload, variance = self.payload_kg(state), float(state.covariance[self._payload, self._payload])
        change, change_std = np.nan, np.nan
        if (before := state.before) is not None:
            change = payload - before.payload_kg
            unlike = (ANSWER_STD * change) ** 2
            shared = before.covariance[self._payload]
            change_std = float(np.sqrt(max(0.0, variance + before.variance - 2 * shared) + unlike))
            variance = variance + unlike
        return PayloadEstimate(payload, float(np.sqrt(variance)), nis, change, change_std)

    def disturbance(self, state: EstimatorState, times_s: Array, period_s: float | None) -> Array:
        """The disturbance (K, 3) [m] at times (K,)."""
        out: Array = self._regressors(times_s, period_s) @ state.z[self._offset :].reshape(-1, 3)
        return out

    def drive(self, state: EstimatorState, pressure_pa: Array) -> tuple[Array, Array]:
        """Static tips (K, 3) of pressures (K, V) with the estimated strengths and payload.

        And their derivatives by the pressures (K, 3, V) [m/Pa].
        """
        gain = 1 + self.gains(state)
        tips, by_pressure = self._map.combined_slopes(pressure_pa * gain, self._load(state))
        return tips, by_pressure * gain

    def _load(self, state: EstimatorState) -> Array:
        """Terms of the payload, which pulls a soft arm farther than the model's: (1 + softness) of its effect."""
        softness = float(state.z[self._soft])
        load: Array = (1 + softness) * self._map.payload_terms(self.payload_kg(state))[
            0
        ] - softness * self._map.payload_terms(0.0)[0]
        return load

    def predict(
        self, state: EstimatorState, tip_m: Array, velocity_m_s: Array, pressure_pa: Array, time_s: float,
        period_s: float | None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Predicted measurement (3,) and its slope (3, n) by z, for the model's tip, velocity and pressures (V,)."""
        gain, (hung, by_payload) = 1 + self.gains(state), self._map.payload_terms(self.payload_kg(state))
        strong, softness = (pressure_pa * gain)[None], float(state.z[self._soft])
        driven, loaded = self._map.combined_slopes(strong, self._load(state))
        shift = driven[0] - self._map.tips(pressure_pa[None])[0]
        known = self._regressors(np.array([time_s]), period_s)[0]
        slope = np.zeros((3, self._size))
        slope[:, : self._valves] = loaded[0] * pressure_pa
        sag = self._map.combined(strong, hung - self._map.payload_terms(0.0)[0])[0]
        slope[:, self._soft] = slope[:, : self._valves].sum(axis=1) + sag
        slope[:, self._lag] = -velocity_m_s
        slope[:, self._payload] = (1 + softness) * self._map.combined(strong, by_payload)[0]
        for axis in range(3):
            slope[axis, self._offset + axis :: 3] = known
        predicted = tip_m + shift - self.lag_s(state) * velocity_m_s + known @ state.z[self._offset :].reshape(-1, 3)
        return predicted, slope

    def update(
        self, state: EstimatorState, measured_m: Array, covariance_m2: Array, prediction: tuple[Array, Array],
        passed_s: float, period_s: float | None,
    ) -> tuple[EstimatorState, float]:  # fmt: skip
        """The state after one frame, and the NIS of its innovation."""
        predicted, slope = prediction
        waves = np.full(6 * HARMONICS, HARMONIC_WALK_M if period_s else 0.0)
        walk = self._each(GAIN_WALK, 0.0, LAG_WALK_S, PAYLOAD_WALK_KG, OFFSET_WALK_M, waves)
        # What has just changed is the payload: the frames after it show its mass, not a drift of the others.
        covariance = state.covariance + (0.0 if state.relapse else 1.0) * np.diag(walk**2) * passed_s
        noise = covariance_m2 + (MODEL_STD_M**2 + state.unmodelled_m2) * np.eye(3)
        gap = measured_m - predicted
        innovation = slope @ covariance @ slope.T + noise
        nis = float(gap @ np.linalg.solve(innovation, gap))
        excess, settling, relapse = 0.0, max(0, state.settling - 1), max(0, state.relapse - 1)
        z, frames, before = state.z, state.frames + 1, state.before
        unmodelled_m2, again = state.unmodelled_m2, max(0, state.again - 1)
        if state.again and state.frames <= LEARNING_FRAMES:
            unmodelled_m2 = _matched(unmodelled_m2, gap, innovation)
        if state.frames > LEARNING_FRAMES and not settling:
            excess = max(0.0, state.excess + min(nis, OUTLIER_NIS) - USUAL_NIS)
            if nis > OUTLIER_NIS and state.excess <= SUSPICION_NIS:
                return state._replace(
                    covariance=covariance, excess=excess, frames=frames, relapse=relapse, suspected=1
                ), nis
            hung = excess > CHANGE_NIS and not relapse and self._payload_explains(state, gap, slope, noise)
            if excess > CHANGE_NIS and not hung:
                z, before = z.copy(), None
                if state.again:
                    unmodelled_m2 += float(gap @ gap) / 3
                else:
                    covariance += np.diag((BEYOND_PRIORS * self._prior_std()) ** 2)
                again = UNMODELLED_FRAMES
                if state.before is not None:
                    covariance[self._payload, self._payload] += (z[self._payload] - state.before.payload_kg) ** 2
                    z[self._payload] = state.before.payload_kg
                excess, frames, relapse = 0.0, LEARNING_FRAMES - LEARNING_AGAIN_FRAMES, 0
            elif hung:
                z, covariance = self._calm(state)
                covariance = covariance.copy()
                column = covariance[:, self._payload].copy()
                before = PayloadClone(float(z[self._payload]), float(column[self._payload]), column)
                covariance[self._payload, self._payload] += JUMP_KG**2
                excess, settling, relapse = 0.0, SETTLING_FRAMES, RELAPSE_FRAMES
            gap = gap - slope @ (z - state.z)
        if settling:
            since_s = (SETTLING_FRAMES - settling) * passed_s
            noise = noise + (SWING_M * np.exp(-since_s / SWING_S)) ** 2 * np.eye(3)
        moves = np.ones(self._size)
        if settling:
            moves = self._each(0.0, 0.0, 0.0, 1.0, 1.0, np.zeros(6 * HARMONICS))
        innovation = slope @ covariance @ slope.T + noise
        gain = moves[:, None] * np.linalg.solve(innovation, slope @ covariance).T
        keep = np.eye(self._size) - gain @ slope
        after = z + gain @ gap, keep @ covariance @ keep.T + gain @ noise @ gain.T  # Joseph form
        suspected, calm = (state.suspected + 1, state.calm) if excess > SUSPICION_NIS else (0, after)
        if before is not None:
            before = before._replace(covariance=keep @ before.covariance)
        return EstimatorState(
            *after, excess, frames, settling, relapse, suspected, calm, before, unmodelled_m2, again
        ), nis

    def _payload_explains(self, state: EstimatorState, gap: Array, slope: Array, noise: Array) -> bool:
        """Whether what a frame shows beyond the estimates that were kept points where a payload pulls the tip."""
        z, covariance = self._calm(state)
        gap, pull = gap - slope @ (z - state.z), slope[:, self._payload]
        weight = np.linalg.inv(slope @ covariance @ slope.T + noise)
        whole, explained = gap @ weight @ gap, (pull @ weight @ gap) ** 2 / (pull @ weight @ pull)
        share = SUDDEN_SHARE if state.suspected <= SUDDEN_FRAMES else EXPLAINED_SHARE
        return bool(explained > share * whole or whole - explained < REST_NIS)

    def _calm(self, state: EstimatorState) -> tuple[Array, Array]:
        return state.calm or (state.z, state.covariance)

    def _prior_std(self) -> Array:
        waves = np.repeat(HARMONIC_STD_M / np.arange(1, HARMONICS + 1), 6)
        return self._each(GAIN_STD, SOFTNESS_STD, LAG_STD_S, PAYLOAD_STD_KG, OFFSET_STD_M, waves)

    def _each(self, gain: float, softness: float, lag: float, payload: float, offset: float, waves: Array) -> Array:
        return np.concatenate([np.full(self._valves, gain), [softness, lag, payload], np.full(3, offset), waves])

    def _regressors(self, times_s: Array, period_s: float | None) -> Array:
        """1, cos and sin of each harmonic (K, 1 + 2 HARMONICS); zeros for the harmonics without a period."""
        out = np.zeros((len(times_s), 1 + 2 * HARMONICS))
        out[:, 0] = 1.0
        if period_s:
            phase = 2 * np.pi / period_s * np.outer(times_s, np.arange(1, HARMONICS + 1))
            out[:, 1::2], out[:, 2::2] = np.cos(phase), np.sin(phase)
        return out


def _matched(variance_m2: float, gap: Array, innovation: Array) -> float:
    """The variance of what the model lacks after one innovation, by covariance matching (Mehra 1972)."""
    expected = float(np.trace(innovation))
    surplus = min(float(gap @ gap), OUTLIER_NIS / 3 * expected) - TOLERATED * expected
    return max(0.0, variance_m2 + UNMODELLED_SHARE * surplus / 3)
