"""How errors of the measured pressures show in the predictions, at rest and in motion.

Near its first mode an arm in motion responds to a pressure several times as much as at rest, and goes on to swing. So
errors of the pressures that are independent from frame to frame become errors of the predictions that are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs

from model.arrays import Array

# A response is followed so long: the first mode of a soft arm has decayed then. Of predictions of many numbers it is
# shorter, for the effort grows with the square of this many numbers.
RESPONSE_S, _MOST_NUMBERS = 1.0, 200
# What follows is left out where it has a smaller share of the variance.
_DECAYED = 1e-4
# Weights of three frames that leave out slow errors.
_HIGH_PASS = (-0.25, 0.5, -0.25)
# Frames of a motion before its first response: the curve through the pressures starts one frame before an error.
_BEFORE, _FIRST = 1, 2
# Frames of a motion that is too short for a response.
SHORTEST = 8


def response_frames(count: int, period_s: float, numbers: int) -> int:
    """Frames L of a response, in a motion of so many frames with so many numbers each."""
    return max(len(_HIGH_PASS), min(round(RESPONSE_S / period_s), _MOST_NUMBERS // numbers, count - _FIRST - 1))


def combs(count: int, frames: int) -> list[NDArray[np.intp]]:
    """Two sets of frames in a motion of K = `count`, each far enough apart that their responses do not overlap."""
    last = count - frames + _BEFORE
    return [np.arange(first, last + 1, frames) for first in sorted({_FIRST, min(_FIRST + frames // 2, last)})]


@dataclass(frozen=True)
class MotionResponse:
    """Response of predictions in a motion to errors of the pressures in its frames.

    impulse (M, L, D, E) [m, rad per unit]: predictions, from the frame before on, by E errors in one frame, for M
    frames. nearest (K,): the one of these that stands for each frame. std (K, E): standard deviations of the errors,
    which are independent.
    """

    impulse: Array
    nearest: NDArray[np.intp]
    std: Array

    @classmethod
    def of_combs(cls, slopes: Array, sets: list[NDArray[np.intp]], frames: int, std: Array) -> MotionResponse:
        """From derivatives (K, D, sets, N) of predictions by the pressures of all frames of each set together.

        Errors of fast frequencies, to which the arm does not respond, are added by the response at rest: there the
        model is not known to be better.
        """
        at = np.concatenate(sets)
        comb = np.repeat(np.arange(len(sets)), [len(one) for one in sets])
        rows = at[:, None] - _BEFORE + np.arange(frames)
        nearest = np.abs(np.arange(len(slopes))[:, None] - at).argmin(axis=1)
        impulse = slopes[rows, :, comb[:, None]]
        power = np.einsum("mldn,n->ld", np.square(impulse), np.square(std).mean(axis=0))
        left = np.cumsum(power[::-1], axis=0)[::-1]
        length = int((left > _DECAYED * left[0]).any(axis=1).sum())
        impulse = impulse[:, : max(length, len(_HIGH_PASS))]
        fast = np.zeros_like(impulse)
        fast[:, : len(_HIGH_PASS)] = np.multiply.outer(_HIGH_PASS, impulse.sum(axis=1)).swapaxes(0, 1)
        return cls(np.concatenate([impulse, fast], axis=3), nearest, np.concatenate([std, std], axis=1))

    @cached_property
    def lagged(self) -> Array:
        """Covariances (L, K, D, D) of the predictions in each frame with those of 0 .. L - 1 frames before."""
        response = self.impulse[self.nearest] * self.std[:, None, None, :]
        count, frames, numbers = response.shape[:3]
        out = np.zeros((frames, count, numbers, numbers))
        for later in range(frames):
            # In these frames an error shows after so many frames.
            first, last = max(0, _BEFORE - later), min(count, count + _BEFORE - later)
            seen = slice(first - _BEFORE + later, last - _BEFORE + later)
            for lag in range(later + 1):
                product = response[first:last, later] @ np.swapaxes(response[first:last, later - lag], 1, 2)
                out[lag, seen] += product
        for lag in range(1, frames):
            out[lag, :lag] = 0.0
        return out

    @property
    def covariance(self) -> Array:
        """Covariances (K, D, D) of the predictions in each frame."""
        out: Array = self.lagged[0]
        return out


@dataclass(frozen=True)
class BandedFactor:
    """Cholesky factor of a banded covariance of K frames of D numbers: its lower bands (B, K D)."""

    bands: Array

    @classmethod
    def of(cls, covariance: Array, lagged: Array, measured: NDArray[np.bool_]) -> BandedFactor:
        """From covariances (K, D, D) within each frame, and those (L, K, D, D) with frames before, of which the first
        is not used. What was not measured (K, D) counts as independent with a unit variance."""
        frames, count, numbers = lagged.shape[:3]
        bands = np.zeros((frames * numbers, count * numbers))
        for lag in range(frames):
            both = measured[lag:, :, None] & measured[: count - lag, None, :]
            block = np.where(both, (lagged[lag] if lag else covariance)[lag:], 0.0)
            if not lag:
                block = block + ~measured[:, :, None] * np.eye(numbers)
            for i in range(numbers):
                for j in range(numbers):
                    band = lag * numbers + i - j
                    if band >= 0:
                        bands[band, j : (count - lag) * numbers : numbers] = block[:, i, j]
        return cls(cholesky_banded(bands, lower=True))

    @property
    def diagonal(self) -> Array:
        """Diagonal (K D,)."""
        out: Array = self.bands[0]
        return out

    def solve(self, rows: Array) -> Array:
        """The inverse of the factor times rows (K, D, n)."""
        if not rows.size:
            return rows
        found, _ = dtbtrs(self.bands, rows.reshape(self.bands.shape[1], -1), uplo="L")
        out: Array = found.reshape(rows.shape)
        return out

    def times(self, column: Array) -> Array:
        """The factor times a column (K D,)."""
        out = np.zeros_like(column)
        for band, own in enumerate(self.bands):
            out[band:] += own[: len(column) - band] * column[: len(column) - band]
        return out


class PressureErrors(NamedTuple):
    """Errors of K predictions, D numbers each, by errors of the measured pressures.

    independent (K, D, D): covariances of those by errors that are independent from entry to entry. common (K, D, m):
    those that all entries share, per unit of m independent unit normal coefficients. motion: the response by which the
    independent ones spread over the frames that follow; None at rest, where they do not.
    """

    independent: Array
    common: Array
    motion: MotionResponse | None = None

    @property
    def covariance(self) -> Array:
        """Covariances (K, D, D) of all of them together."""
        out: Array = self.independent + self.common @ np.swapaxes(self.common, 1, 2)
        return out
