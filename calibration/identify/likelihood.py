"""Likelihood of measured tips: whitened residuals, Huber loss, model discrepancy, HAC score covariance."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import brentq
from scipy.special import chdtr, chdtri

from calibration.identify.poses import TIP, TIP_ROTATION, Poses
from calibration.identify.pressure_response import BandedFactor, MotionResponse
from model.arrays import Array

# Threshold of the Huber loss, as a Mahalanobis distance: 1 % of normal tips lie beyond it.
OUTLIER = math.sqrt(chdtri(3, 0.01))
# Expected square per axis of a normal tip, clipped at the threshold.
_EXPECTED_SQUARE = float(chdtr(5, OUTLIER**2)) + OUTLIER**2 * 0.01 / 3
_UNSOLVED_RESIDUAL = 1e3
# Discrepancies that differ by a smaller share give the same weights.
_SAME = 0.02
_MAX_DISCREPANCY = 10.0
# Pressures have a signal at a frequency where their power, smoothed over so many bins, exceeds this ratio to noise.
_SMOOTHING_BINS, _MIN_SNR = 5, 200.0
# The mask falls from 1 at the highest of these frequencies to 0 at this multiple of it.
_ROLLOFF = 1.5
# Bins of the lowest frequency band, the prior count with which a band is shrunk towards the next higher one, and the
# largest growth of the noise level per octave: a random walk grows by four.
_FIRST_BAND, _PRIOR_COUNT, _MAX_GROWTH = 5, 8.0, 4.0
# Ratio of the power in the lowest band to that in the next one that indicates a drift.
_DRIFT_RATIO = 5.0


@dataclass(frozen=True)
class Discrepancy:
    """Standard deviations per axis of the model error beyond the stated covariances: of tips and of their rotations.

    sections: the same of points and rotations of sections, by their kind of `Poses.kinds`.
    """

    tip_m: float
    rotation_rad: float = 0.0
    sections: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def by_kind(cls, found: Mapping[str, float]) -> Discrepancy:
        """From standard deviations by kind; zero for a kind that is not there."""
        sections = {kind: sigma for kind, sigma in found.items() if kind not in (TIP, TIP_ROTATION)}
        return cls(found.get(TIP, 0.0), found.get(TIP_ROTATION, 0.0), sections)

    @classmethod
    def estimated(
        cls, data: Sequence[Poses], gaps: Sequence[Array], covariances: Sequence[Array], fitted: float
    ) -> Discrepancy:
        """That of each run's gaps (K, D) with stated covariances (K, D, D), after a fit of so many unknowns.

        Each kind of numbers determines its part of the unknowns.
        """
        kinds = dict.fromkeys(kind for poses in data for kind in poses.kinds)
        residual: dict[str, list[Array]] = {kind: [] for kind in kinds}
        stated: dict[str, list[Array]] = {kind: [] for kind in kinds}
        count = dict.fromkeys(kinds, 0)
        for poses, gap, covariance in zip(data, gaps, covariances, strict=True):
            for kind in poses.kinds:
                part = poses.columns(kind)
                measured = poses.measured[:, part].all(axis=1)
                count[kind] += 3 * int(measured.sum())
                known = measured & np.isfinite(gap[:, part]).all(axis=1)
                residual[kind].append(gap[known, part])
                stated[kind].append(covariance[known, part, part])
        share = fitted / max(sum(count.values()), 1)
        return cls.by_kind({k: discrepancy(residual[k], stated[k], share * count[k]) for k in kinds if count[k]})

    @property
    def of_kinds(self) -> dict[str, float]:
        """All standard deviations by kind."""
        return {TIP: self.tip_m, TIP_ROTATION: self.rotation_rad, **self.sections}

    def close_to(self, other: Discrepancy) -> bool:
        """Whether it differs from another by so little that the weights are the same."""
        there = other.of_kinds
        return all(abs(one - there.get(kind, math.inf)) <= _SAME * one for kind, one in self.of_kinds.items())

    def scaled(self, share: float) -> Discrepancy:
        """A share of it."""
        return Discrepancy.by_kind({kind: share * sigma for kind, sigma in self.of_kinds.items()})

    def covariance(self, kinds: Sequence[str]) -> Array:
        """Covariance (D, D) of the numbers of an entry, three of each kind."""
        sigma = self.of_kinds
        out: Array = np.diag(np.square(np.repeat([sigma.get(kind, 0.0) for kind in kinds], 3)))
        return out


@dataclass(frozen=True)
class Weights:
    """Weights of one `Poses` with D numbers per entry: `whitener` (K, D, D) makes residuals [m, rad] unit normal.

    Its rows are zero where nothing was measured. It is lower triangular: the tips are whitened as without rotations.
    factor: Cholesky factor of the whole covariance, where entries correlate; it then takes the place of `whitener`.
    common (K, D, m): errors that all entries share, per unit of m independent unit normal coefficients. Whitened, they
    are basis (K D, m) times orthogonal coefficients, and `shrink` (m,) makes these unit normal, too. log_det:
    ln det(2 pi C) of what was measured.
    """

    whitener: Array
    common: Array
    basis: Array
    shrink: Array
    log_det: float
    factor: BandedFactor | None = None

    @classmethod
    def of(
        cls,
        covariance: Array,
        measured: NDArray[np.bool_],
        common: Array | None = None,
        motion: MotionResponse | None = None,
    ) -> Weights:
        """From covariances (K, D, D) of measured minus predicted, and which numbers (K, D) were measured.

        common (K, D, m): errors that all entries share, beside these. motion: response to errors of the pressures,
        whose covariances are part of these.
        """
        whitener = np.zeros_like(covariance)
        seen = measured[:, 0]
        lower = np.linalg.cholesky(covariance[seen])
        whitener[seen] = np.linalg.inv(lower)
        whitener[~measured] = 0.0
        logs = np.log(np.diagonal(lower, axis1=1, axis2=2))[measured[seen]]
        log_det = float(2 * logs.sum() + logs.size * math.log(2 * math.pi))
        factor = None if motion is None else BandedFactor.of(covariance, motion.lagged, measured)
        if factor is not None:
            log_det += 2 * float(np.log(factor.diagonal).sum() - logs.sum())
        if common is None:
            common = np.zeros((*measured.shape, 0))
        # By the covariance I + U U' of whitened residuals, of which U has few columns.
        shared = whitener @ common if factor is None else factor.solve(np.where(measured[:, :, None], common, 0.0))
        basis, sizes, _ = np.linalg.svd(shared.reshape(measured.size, -1), full_matrices=False)
        shrink = 1 / np.hypot(1.0, sizes) - 1
        return cls(whitener, common, basis, shrink, log_det + float(np.log1p(sizes**2).sum()), factor)

    @property
    def shared(self) -> bool:
        """Whether the entries share errors."""
        return bool(self.shrink.any())

    def whitened(self, rows: Array) -> Array:
        """Residuals (K, D), or derivatives of them (K, D, n), in uncorrelated standard deviations."""
        flat = rows.reshape(*self.whitener.shape[:2], -1)
        if self.factor is None:
            flat = np.einsum("kij,kjn->kin", self.whitener, flat)
        else:
            measured = np.asarray(self.whitener.any(axis=2))
            flat = self.factor.solve(np.where(measured[:, :, None], flat, 0.0))
        flat = flat.reshape(len(self.basis), -1)
        if self.shared:
            flat = flat + self.basis @ (self.shrink[:, None] * (self.basis.T @ flat))
        out: Array = flat.reshape(rows.shape)
        return out

    def drawn(self, rng: np.random.Generator) -> Array:
        """Errors (K, D) with the covariance of these weights."""
        unit = rng.standard_normal(self.whitener.shape[:2])
        if self.factor is None:
            error = np.einsum("kij,kj->ki", np.linalg.pinv(self.whitener), unit)
        else:
            error = self.factor.times(unit.ravel()).reshape(unit.shape)
        out: Array = error + self.common @ rng.standard_normal(self.common.shape[2])
        return out


def whitened(poses: Poses, gap: Array, weights: Weights) -> Array:
    """Residuals (K, D) in standard deviations of gaps (K, D) [m, rad]; zero where nothing was measured."""
    difference = np.where(poses.measured, gap, 0.0)
    # An unsolved prediction is a bad one, not a missing one.
    unsolved = ~np.isfinite(difference)
    out = weights.whitened(np.where(unsolved, 0.0, difference))
    out[unsolved] = _UNSOLVED_RESIDUAL
    return out


def outlying(residual: Array) -> NDArray[np.bool_]:
    """Which entries (K,) have a tip or a rotation beyond the threshold; residual (K, D) in standard deviations."""
    found: NDArray[np.bool_] = np.asarray((_distances(residual) > OUTLIER).any(axis=1))
    return found


def _distances(residual: Array) -> Array:
    """Mahalanobis distances (K, D / 3) of tips and rotations."""
    out: Array = np.linalg.norm(residual.reshape(len(residual), -1, 3), axis=2)
    return out


def huber(residual: Array, slope: Array | None = None) -> tuple[Array, Array | None]:
    """Residuals (K, D) whose squares sum to the Huber loss of the Mahalanobis distances, and their slopes.

    Each tip and each rotation has a distance of its own. slope (K, D, n): derivatives of the residuals; returned
    transformed alike.
    """
    shape = residual.shape
    triples = residual.reshape(-1, 3)
    distance = np.linalg.norm(triples, axis=1)
    far = distance > OUTLIER
    r = np.where(far, distance, 1.0)
    scale = np.where(far, np.sqrt(np.maximum(2 * OUTLIER * r - OUTLIER**2, 0.0)) / r, 1.0)
    robust = (triples * scale[:, None]).reshape(shape)
    if slope is None:
        return robust, None
    # d scale / d r by the definition above; zero where the tip is no outlier.
    change = np.where(far, OUTLIER / (r**2 * scale) - scale / r, 0.0)
    slopes = slope.reshape(len(triples), 3, slope.shape[2])
    along = np.einsum("ki,kin->kn", triples, slopes) / r[:, None]
    turned = slopes * scale[:, None, None] + triples[:, :, None] * (change[:, None] * along)[:, None, :]
    return robust, turned.reshape(slope.shape)


def discrepancy(residuals: Sequence[Array], covariances: Sequence[Array], free: float) -> float:
    """Standard deviation per axis of the model error beyond the stated covariances, in the unit of the residuals.

    residuals, covariances: per run (K, 3), (K, 3, 3) of what was measured only. Zero unless the residuals are
    significantly too large; else the value for which the mean clipped square has its expectation.
    """
    residual, covariance = np.concatenate(residuals), np.concatenate(covariances)
    freedom = max(residual.size - free, 1.0)
    values, vectors = np.linalg.eigh(covariance)
    turned2 = np.einsum("kji,kj->ki", vectors, residual) ** 2

    def excess(sigma: float) -> float:
        distance2 = (turned2 / (values + sigma**2)).sum(axis=1)
        return float(np.minimum(distance2, OUTLIER**2).sum()) / (freedom * _EXPECTED_SQUARE) - 1

    if excess(0.0) <= math.sqrt(2 / freedom) * 2.33:
        return 0.0
    if excess(_MAX_DISCREPANCY) > 0:
        return _MAX_DISCREPANCY
    return float(brentq(excess, 0.0, _MAX_DISCREPANCY, xtol=1e-9))


def frequency_mask(poses: Poses) -> Array:
    """Gain (K // 2 + 1,) of each frequency of a motion's residuals: 1, or 0 where the pressures are only noise.

    Noise in the measured pressures moves the model but not the arm, so it biases the fit towards models that respond
    less. Stronger smoothing of the pressures would remove signal from the model that is still in the tips.
    """
    count = len(poses)
    window = np.hanning(count)[:, None]
    power = np.abs(np.fft.rfft((poses.pressure_pa - poses.pressure_pa.mean(axis=0)) * window, axis=0)) ** 2
    noise = (poses.pressure_std_pa**2).mean(axis=0) * (window**2).sum()
    shown = uniform_filter1d(power, _SMOOTHING_BINS, axis=0, mode="nearest") > _MIN_SNR * noise
    highest = max((int(np.flatnonzero(column).max(initial=0)) for column in shown.T), default=0)
    over = np.arange(count // 2 + 1) / max(highest, 1)
    out: Array = 0.5 + 0.5 * np.cos(np.pi * np.clip((over - 1) / (_ROLLOFF - 1), 0.0, 1.0))
    return out


def apply_frequency_mask(rows: Array, gain: Array) -> Array:
    """Rows (K, ..) with each frequency multiplied by `gain` (K // 2 + 1,)."""
    if (gain == 1.0).all():
        return rows
    shape = (len(gain), *(1,) * (rows.ndim - 1))
    out: Array = np.fft.irfft(np.fft.rfft(rows, axis=0) * gain.reshape(shape), len(rows), axis=0)
    return out


def drifting(residual: Array) -> bool:
    """Whether residuals (K, D), in standard deviations, correlate over more than a tenth of the entries.

    Their power then still rises at the lowest frequencies, and its limit at frequency zero is not observable.
    """
    if len(residual) < 4 * _FIRST_BAND:
        return False
    power = np.abs(np.fft.rfft(residual, axis=0)[1 : 2 * _FIRST_BAND]) ** 2
    return bool(power[: _FIRST_BAND - 1].mean() > _DRIFT_RATIO * power[_FIRST_BAND - 1 :].mean())


def score_covariance(
    residual: Array, slope: Array, gain: Array, seen: float, covariance: Array, at_least_stated: bool = False
) -> Array:
    """Score covariance (n, n) of correlated residuals, by a HAC estimator; slope' slope if they are independent.

    residual (K, D), slope (K, D, n): in standard deviations, after `apply_frequency_mask`. seen: fraction of entries
    with a tip. covariance (n, n): of the unknowns under independence. The noise spectrum is estimated per octave and
    axis, corrected for the fitted degrees of freedom. Bands with few bins are shrunk towards the next higher band,
    extrapolated by its significant growth. The mean level is at least the stated one: an error common to a whole run
    does not show in its residuals. at_least_stated: in every band; where the stated errors are shared by all entries,
    the residuals of a band tell little of those that the unknowns absorb.
    """
    count = len(residual)
    twice = np.where((np.arange(len(gain)) == 0) | (2 * np.arange(len(gain)) == count), 1.0, 2.0)
    power = twice[:, None] * np.abs(np.fft.rfft(residual, axis=0, norm="ortho")) ** 2
    turned = np.fft.rfft(slope, axis=0, norm="ortho")
    fitted = twice[:, None] * np.einsum("fin,nm,fim->fi", turned.conj(), covariance, turned).real
    free = np.maximum(seen * (twice * gain**2)[:, None] - fitted, 0.0)
    level = np.ones_like(power)
    edges = [0, *(_FIRST_BAND * 2**k for k in range(64) if _FIRST_BAND * 2**k < len(gain)), len(gain)]
    before, growth, known = np.ones(residual.shape[1]), 1.0, math.inf
    for first, last in reversed(list(itertools.pairwise(edges))):
        band = slice(first, last)
        numbers = free[band].sum(axis=0) + _PRIOR_COUNT
        now = (power[band].sum(axis=0) + _PRIOR_COUNT * growth * before) / numbers
        chance = 1 + math.sqrt(2 / numbers.sum() + 2 / known)
        growth = float(np.clip(now.mean() / before.mean() / chance, 1.0, _MAX_GROWTH))
        before, known = now, numbers.sum()
        # Mean of the inverse-gamma posterior of a variance from few numbers.
        level[band] = before * numbers / (numbers - 2)
    if free.any():
        level /= min(1.0, float((level * free).sum() / free.sum()))
    if at_least_stated:
        level = np.maximum(level, 1.0)
    weight = level * (twice * gain**2)[:, None]
    out: Array = np.einsum("fin,fi,fim->nm", turned.conj(), weight, turned).real
    return out
