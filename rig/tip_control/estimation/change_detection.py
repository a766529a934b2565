"""Detection of sudden changes by a CUSUM of the normalised innovation squared (Page 1954)."""

from __future__ import annotations

from enum import Enum, auto
from typing import NamedTuple

import numpy as np

from model.arrays import Array
from rig.tip_control.estimation import tuning
from rig.tip_control.estimation.state import EstimatorState


class Change(Enum):
    """What a frame shows."""

    NONE = auto()
    OUTLIER = auto()
    """One measurement far off: it is not used."""
    PAYLOAD = auto()
    OTHER = auto()
    """An arm beyond the priors, or a disturbance beyond the model."""


class Innovation(NamedTuple):
    """Innovation `gap` (3,) of a frame, Jacobian (3, n), noise (3, 3) of the measurement, and NIS."""

    gap: Array
    jacobian: Array
    noise: Array
    nis: float


def detected(state: EstimatorState, found: Innovation, payload: int) -> tuple[Change, float]:
    """What a frame shows, and the CUSUM after it; `payload` is the index of that estimate."""
    cusum = state.detector.cusum
    if state.frames <= tuning.FIRST_FRAMES or state.settling > 1:
        return Change.NONE, 0.0
    risen = max(0.0, cusum + min(found.nis, tuning.LARGEST_NIS) - tuning.REFERENCE_NIS)
    if found.nis > tuning.LARGEST_NIS and cusum <= tuning.RISING:
        return Change.OUTLIER, risen
    if risen <= tuning.THRESHOLD:
        return Change.NONE, risen
    if state.confirming <= 1 and _payload_explains(state, found, payload):
        return Change.PAYLOAD, 0.0
    return Change.OTHER, 0.0


def before_change(state: EstimatorState) -> tuple[Array, Array]:
    """Estimates and covariance before the CUSUM began to rise."""
    return state.detector.kept or (state.z, state.covariance)


def matched_variance(variance_m2: float, gap: Array, expected: Array) -> float:
    """The variance that is added to the measurement, after one innovation, by covariance matching (Mehra 1972)."""
    trace = float(np.trace(expected))
    surplus = min(float(gap @ gap), tuning.LARGEST_NIS / 3 * trace) - tuning.TOLERATED * trace
    return max(0.0, variance_m2 + tuning.GAIN * surplus / 3)


def _payload_explains(state: EstimatorState, found: Innovation, payload: int) -> bool:
    """Whether the innovation against the estimates before the change points where a payload pulls the tip."""
    z, covariance = before_change(state)
    jacobian = found.jacobian
    gap, pull = found.gap - jacobian @ (z - state.z), jacobian[:, payload]
    weight = np.linalg.inv(jacobian @ covariance @ jacobian.T + found.noise)
    whole, explained = gap @ weight @ gap, (pull @ weight @ gap) ** 2 / (pull @ weight @ pull)
    sudden = state.detector.rising_frames <= tuning.SUDDEN_FRAMES
    share = tuning.SUDDEN_EXPLAINED if sudden else tuning.EXPLAINED
    return bool(explained > share * whole or whole - explained < tuning.UNEXPLAINED_NIS)
