"""How likely measured tips are under predicted ones: whitened residuals, robust against outliers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
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
# Pressures show something at a frequency where their power, over so many neighbours, is so many times their noise's.
_NEIGHBOURS, _SHOWN = 5, 200.0
# From the highest of these to so many times that, residuals cease to count.
_FADED = 1.5
# The lowest band of frequencies whose scatter is found by itself, on how many numbers' worth of what the higher ones
# make expected it leans, and by how much scatter may grow from an octave to the next: that of a drift, by four.
_LOWEST, _LEAN, _STEEPEST = 5, 8.0, 4.0
# By how much the lowest band scatters more than the next where errors outlast it.
_DRIFT = 5.0


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


def apply_frequency_mask(poses: Poses) -> Array:
    """How much each frequency (K // 2 + 1,) of a motion's residuals counts: 1, or 0 where pressures show but noise.

    A model that is driven by noise answers to what the arm never felt, and is the likelier the less it answers.
    Smoother pressures would be no way out: what is taken off them is missing in the model and not in the tips.
    """
    count = len(poses)
    window = np.hanning(count)[:, None]
    power = np.abs(np.fft.rfft((poses.pressure_pa - poses.pressure_pa.mean(axis=0)) * window, axis=0)) ** 2
    noise = (poses.pressure_std_pa**2).mean(axis=0) * (window**2).sum()
    shown = uniform_filter1d(power, _NEIGHBOURS, axis=0, mode="nearest") > _SHOWN * noise
    highest = max((int(np.flatnonzero(column).max(initial=0)) for column in shown.T), default=0)
    over = np.arange(count // 2 + 1) / max(highest, 1)
    out: Array = 0.5 + 0.5 * np.cos(np.pi * np.clip((over - 1) / (_FADED - 1), 0.0, 1.0))
    return out


def frequency_mask(rows: Array, gain: Array) -> Array:
    """Rows (K, ..) with each of their frequencies times `gain` (K // 2 + 1,)."""
    if (gain == 1.0).all():
        return rows
    shape = (len(gain), *(1,) * (rows.ndim - 1))
    out: Array = np.fft.irfft(np.fft.rfft(rows, axis=0) * gain.reshape(shape), len(rows), axis=0)
    return out


def drifting(residual: Array) -> bool:
    """Whether neighbouring residuals (K, 3), in standard deviations, share errors that outlast a tenth of the entries.

    Then they scatter more and more towards the lowest frequencies, and nobody sees by how much in the end.
    """
    if len(residual) < 4 * _LOWEST:
        return False
    power = np.abs(np.fft.rfft(residual, axis=0)[1 : 2 * _LOWEST]) ** 2
    return bool(power[: _LOWEST - 1].mean() > _DRIFT * power[_LOWEST - 1 :].mean())


def score_covariance(residual: Array, slope: Array, gain: Array, seen: float, covariance: Array) -> Array:
    """How much the pull (n, n) of neighbouring entries on the unknowns scatters; slope' slope if they are independent.

    residual (K, 3), slope (K, 3, n): in standard deviations, after `through`. seen: part of the entries with a tip.
    covariance (n, n): of the unknowns, if entries were independent. Errors that neighbours share are large where
    frequencies are low, and there the unknowns pull. So what the residuals scatter is found by octaves and axes; what
    has been fitted to them is made up for, and bands of few numbers lean on the higher ones: on the next, and on what
    it has grown by since the one before, beyond chance, as it goes on growing. In all they do not scatter less than
    stated: what the errors of a run have in common does not show.
    """
    count = len(residual)
    twice = np.where((np.arange(len(gain)) == 0) | (2 * np.arange(len(gain)) == count), 1.0, 2.0)
    power = twice[:, None] * np.abs(np.fft.rfft(residual, axis=0, norm="ortho")) ** 2
    turned = np.fft.rfft(slope, axis=0, norm="ortho")
    fitted = twice[:, None] * np.einsum("fin,nm,fim->fi", turned.conj(), covariance, turned).real
    free = np.maximum(seen * (twice * gain**2)[:, None] - fitted, 0.0)
    level = np.ones_like(power)
    edges = [0, *(_LOWEST * 2**k for k in range(64) if _LOWEST * 2**k < len(gain)), len(gain)]
    before, growth, known = np.ones(residual.shape[1]), 1.0, math.inf
    for first, last in reversed(list(itertools.pairwise(edges))):
        band = slice(first, last)
        numbers = free[band].sum(axis=0) + _LEAN
        here = (power[band].sum(axis=0) + _LEAN * growth * before) / numbers
        chance = 1 + math.sqrt(2 / numbers.sum() + 2 / known)
        growth = float(np.clip(here.mean() / before.mean() / chance, 1.0, _STEEPEST))
        before, known = here, numbers.sum()
        # What a variance that was found from few numbers is on average.
        level[band] = before * numbers / (numbers - 2)
    if free.any():
        level /= min(1.0, float((level * free).sum() / free.sum()))
    weight = level * (twice * gain**2)[:, None]
    out: Array = np.einsum("fin,fi,fim->nm", turned.conj(), weight, turned).real
    return out
