"""How likely measured tips are under predicted ones: whitened residuals, robust against outliers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2

from calibration.identify.data import Poses

Array = NDArray[np.float64]

# Mahalanobis distance beyond which a tip counts as an outlier and pulls no harder: 1 % of good tips lie there.
OUTLIER = math.sqrt(chi2.ppf(0.99, 3))
# What a good tip adds on average per axis when outliers are cut off at their bound.
_EXPECTED = float(chi2.cdf(OUTLIER**2, 5)) + OUTLIER**2 * 0.01 / 3
_UNSOLVED = 1e3
_MOST_DISCREPANCY_M = 10.0


@dataclass(frozen=True)
class Weights:
    """How one `Poses` is weighted: `whitener` (K, 3, 3) makes residuals [m] unit normal; zero where no tip is.

    log_det: sum of ln det(2 pi C) over the measured tips.
    """

    whitener: Array
    log_det: float

    @classmethod
    def of(cls, covariance_m2: Array, seen: NDArray[np.bool_]) -> Weights:
        """From covariances (K, 3, 3) [m^2] of measured minus predicted."""
        whitener = np.zeros_like(covariance_m2)
        lower = np.linalg.cholesky(covariance_m2[seen])
        whitener[seen] = np.linalg.inv(lower)
        log_det = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() + 3 * seen.sum() * math.log(2 * math.pi)
        return cls(whitener, float(log_det))


def whitened(poses: Poses, predicted_m: Array, weights: Weights) -> Array:
    """Residuals (K, 3) in standard deviations; zero where no tip was measured."""
    difference = np.where(poses.seen[:, None], poses.tip_m - predicted_m, 0.0)
    # What has no solution is a bad prediction, not a missing one.
    lost = ~np.isfinite(difference)
    out: Array = np.einsum("kij,kj->ki", weights.whitener, np.where(lost, 0.0, difference))
    out[lost] = _UNSOLVED
    return out


def damped(residual: Array, slope: Array | None = None) -> tuple[Array, Array | None]:
    """Residuals (K, 3) whose squares sum to Huber's loss of each tip's Mahalanobis distance, and their slopes.

    slope (K, 3, n): derivatives of the residuals; returned transformed alike.
    """
    distance = np.linalg.norm(residual, axis=1)
    far = distance > OUTLIER
    r = np.where(far, distance, 1.0)
    scale = np.where(far, np.sqrt(np.maximum(2 * OUTLIER * r - OUTLIER**2, 0.0)) / r, 1.0)
    if slope is None:
        return residual * scale[:, None], None
    # d scale / d r by the definition above; zero where the tip is no outlier.
    change = np.where(far, OUTLIER / (r**2 * scale) - scale / r, 0.0)
    along = np.einsum("ki,kin->kn", residual, slope) / r[:, None]
    return residual * scale[:, None], slope * scale[:, None, None] + residual[:, :, None] * (change[:, None] * along)[
        :, None, :
    ]


def discrepancy(residual_m: Sequence[Array], covariance_m2: Sequence[Array], free: int) -> float:
    """Standard deviation [m] per axis by which the model is wrong beyond the stated covariances.

    residual_m, covariance_m2: per run (K, 3), (K, 3, 3) of measured tips only. Zero unless the residuals are larger
    than chance allows; else such that what lies within the outliers' bound has the size expected of it.
    """
    residual, covariance = np.concatenate(residual_m), np.concatenate(covariance_m2)
    freedom = max(residual.size - free, 1)
    values, vectors = np.linalg.eigh(covariance)
    turned2 = np.einsum("kji,kj->ki", vectors, residual) ** 2

    def excess(sigma: float) -> float:
        distance2 = (turned2 / (values + sigma**2)).sum(axis=1)
        return float(np.minimum(distance2, OUTLIER**2).sum()) / (freedom * _EXPECTED) - 1

    if excess(0.0) <= math.sqrt(2 / freedom) * 2.33:
        return 0.0
    if excess(_MOST_DISCREPANCY_M) > 0:
        return _MOST_DISCREPANCY_M
    return float(brentq(excess, 0.0, _MOST_DISCREPANCY_M, xtol=1e-9))


def correlation_time(residual: Array) -> float:
    """How many neighbouring entries of whitened residuals (K, 3) tell the same: 1 when they are independent.

    Integrated autocorrelation time, summed while pairs of neighbouring lags stay positive.
    """
    n = len(residual)
    power = float((residual**2).sum())
    if n < 8 or power == 0:
        return 1.0
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(residual, size, axis=0)) ** 2
    rho = np.fft.irfft(spectrum, size, axis=0)[:n].sum(axis=1) / power
    pairs = rho[0 : n - 1 : 2] + rho[1:n:2]
    stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    return max(1.0, 2 * float(pairs[:stop].sum()) - 1)
