"""State of the estimator between two frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from model.arrays import Array

HARMONICS = 4


@dataclass(frozen=True)
class EstimateLayout:
    """Places of the estimates of an arm with V valves in the vector z (n,).

    Strengths (V,), softness, retardation, lag, payload, offset (3,), then cosine (3,) and sine (3,) of each harmonic.
    """

    valves: int

    @property
    def softness(self) -> int:
        """Index of the softness."""
        return self.valves

    @property
    def retardation(self) -> int:
        """Index of the change of the retardation time."""
        return self.valves + 1

    @property
    def payload(self) -> int:
        """Index of the payload."""
        return self.valves + 3

    @property
    def offset(self) -> slice:
        """The constant part of the disturbance."""
        return slice(self.valves + 4, self.valves + 7)

    @property
    def size(self) -> int:
        """Number of estimates."""
        return self.valves + 7 + 6 * HARMONICS

    def vector(
        self,
        strength: float,
        softness: float,
        retardation: float,
        lag: float,
        payload: float,
        offset: float,
        harmonics: Array,
    ) -> Array:
        """A vector (n,) of one value for each kind of estimate, and one (HARMONICS,) for each harmonic."""
        single = [softness, retardation, lag, payload]
        return np.concatenate([np.full(self.valves, strength), single, np.full(3, offset), np.repeat(harmonics, 6)])


class DetectorState(NamedTuple):
    """The CUSUM, the frames since it began to rise, and the estimates and their covariance before that."""

    cusum: float = 0.0
    rising_frames: int = 0
    kept: tuple[Array, Array] | None = None


class EstimatorState(NamedTuple):
    """Estimates `z` (n,) with covariance (n, n), and what the detection of changes keeps.

    `frames`: since the start, or since the priors were widened. `settling`: frames until the arm has settled after a
    change. `confirming`: frames in which a second change is none of the payload. `payload_before_kg`: before the last
    change, None without any. `unmodelled_m2`: variance of each coordinate by what the estimates cannot follow, as of a
    motion too fast for the model; `adapting`: frames in which it may grow.
    """

    z: Array
    covariance: Array
    frames: int = 0
    detector: DetectorState = DetectorState()
    settling: int = 0
    confirming: int = 0
    payload_before_kg: float | None = None
    unmodelled_m2: float = 0.0
    adapting: int = 0
