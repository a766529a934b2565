"""Named models of the noise: the covariance R of measured minus predicted, one block (D, D) for each entry."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import chdtr, chdtri

from calibration.identify.observations.poses import Poses
from calibration.identify.prediction.forward_model import ForwardModel
from model.arrays import Array

# Threshold of an outlier, as a Mahalanobis distance: 1 % of normal tips lie beyond it.
OUTLIER = math.sqrt(chdtri(3, 0.01))
# Expected square per axis of a normal tip, clipped at the threshold.
_EXPECTED_SQUARE = float(chdtr(5, OUTLIER**2)) + OUTLIER**2 * 0.01 / 3
# Whitened residual of a prediction without a solution: a bad one, not a missing one.
_UNSOLVED = 1e3
# The extra standard deviation is zero unless the residuals are so many standard errors of a variance too large.
_SIGNIFICANT = 2.33
# Largest extra standard deviation [m, rad].
_MOST = 10.0
# Error of a prediction before any fit, over the motion of the tips.
_FIRST_SHARE = 0.05


@dataclass(frozen=True)
class RunNoise:
    """R of one run: covariances (K, D, D) of its entries, and which numbers (K, D) were measured.

    correlation: so many correlated entries count as one, which is in the covariances.
    """

    covariance: Array
    measured: NDArray[np.bool_]
    correlation: float = 1.0

    def __post_init__(self) -> None:
        root = np.zeros_like(self.covariance)
        seen = self.measured[:, 0]
        root[seen] = np.linalg.inv(np.linalg.cholesky(self.covariance[seen]))
        root[~self.measured] = 0.0
        object.__setattr__(self, "_root", root)

    def fewer(self, correlation: float) -> RunNoise:
        """The same with so many entries for one."""
        return RunNoise(correlation * self.covariance, self.measured, correlation)

    def whitened(self, rows: Array) -> Array:
        """R^-1/2 times numbers (K, D) or their derivatives (K, D, n); zero where nothing was measured."""
        root: Array = self._root  # type: ignore[attr-defined]
        out: Array = np.einsum("kij,kj...->ki...", root, rows)
        return out

    def whitened_gap(self, gap: Array) -> Array:
        """R^-1/2 times measured minus predicted (K, D)."""
        known = np.where(self.measured, gap, 0.0)
        unsolved = ~np.isfinite(known)
        out = self.whitened(np.where(unsolved, 0.0, known))
        out[unsolved] = _UNSOLVED
        return out

    @property
    def log_det(self) -> float:
        """Logarithm of det(2 pi R) of what was measured."""
        roots = np.diagonal(self._root, axis1=1, axis2=2)[self.measured]  # type: ignore[attr-defined]
        return float(roots.size * math.log(2 * math.pi) - 2 * np.log(roots).sum())


@dataclass(frozen=True)
class Noise:
    """R of all runs. extra: standard deviation per axis beyond the stated errors, by kind of number (`Poses.kinds`)."""

    runs: tuple[RunNoise, ...]
    extra: Mapping[str, float]

    def close_to(self, other: Noise) -> bool:
        """Whether it weighs the data as another does, to a few per cent."""
        there = other.extra
        same = all(
            math.isclose(s, there.get(kind, math.inf), rel_tol=0.02, abs_tol=1e-12) for kind, s in self.extra.items()
        )
        pairs = zip(self.runs, other.runs, strict=True)
        return same and all(math.isclose(a.correlation, b.correlation, rel_tol=0.1) for a, b in pairs)


@dataclass(frozen=True)
class NoiseModel:
    """How R is made: R = c H (C + P + s^2 I) H for each entry.

    C is the stated covariance of the measurement. adaptive: P, by errors of the measured pressures; s^2, the variance
    that makes the mean square of the residuals as large as stated, of each kind of number; c >= 1, by which the
    correlation of a run's residuals makes its entries fewer; H, which weighs outliers as the Huber loss does
    (iteratively reweighted least squares). Otherwise R = C: weighted least squares as in textbooks.
    """

    name: str
    adaptive: bool

    def at(self, forward: ForwardModel, theta: Array, fitted: float) -> Noise:
        """R by the residuals at theta, of a fit that has determined so many unknowns."""
        stated = [poses.pose_covariance for poses in forward.data]
        measured = [poses.measured for poses in forward.data]
        if not self.adaptive:
            return Noise(tuple(RunNoise(c, m) for c, m in zip(stated, measured, strict=True)), {})
        gaps = forward.gaps(theta)
        stated = [one + by for one, by in zip(stated, forward.pressure_covariances(theta), strict=True)]
        extra = _extra(forward.data, gaps, stated, fitted)
        runs = []
        for poses, gap, covariance, seen in zip(forward.data, gaps, stated, measured, strict=True):
            variance = np.repeat([extra.get(kind, 0.0) ** 2 for kind in poses.kinds], 3)
            own = RunNoise(covariance + np.diag(variance), seen)
            far = np.repeat(np.sqrt(np.maximum(distances(own.whitened_gap(gap)) / OUTLIER, 1.0)), 3, axis=1)
            runs.append(RunNoise(far[:, :, None] * own.covariance * far[:, None, :], seen))
        sequences = [one.in_sequence for one in forward.data]
        whitened = [run.whitened_gap(gap) for run, gap, own in zip(runs, gaps, sequences, strict=True) if own]
        count = correlation(whitened) if whitened else 1.0
        return Noise(tuple(run.fewer(count) if own else run for run, own in zip(runs, sequences, strict=True)), extra)

    def first(self, forward: ForwardModel) -> Noise:
        """R before any fit: errors of a share of the motion of the tips, so that the data lead the search."""
        if not self.adaptive:
            return self.at(forward, forward.first, 0.0)
        runs = []
        for poses, by in zip(forward.data, forward.pressure_covariances(forward.first), strict=True):
            moved_m2 = float(np.nanvar(poses.tip_m, axis=0).sum()) if poses.has_tip.any() else 0.0
            runs.append(
                RunNoise(
                    poses.pose_covariance + by + _FIRST_SHARE**2 * moved_m2 * np.eye(poses.numbers), poses.measured
                )
            )
        return Noise(tuple(runs), {})


NOISE_MODELS = {one.name: one for one in (NoiseModel("adaptive", True), NoiseModel("white", False))}


def distances(residual: Array) -> Array:
    """Mahalanobis distances (K, D / 3) of points and rotations from whitened residuals (K, D)."""
    out: Array = np.linalg.norm(residual.reshape(len(residual), -1, 3), axis=2)
    return out


def correlation(residuals: Sequence[Array]) -> float:
    """How many entries of runs count as one: the integrated autocorrelation time of whitened residuals (K, D) of each.

    1 + 2 sum rho_k up to the first rho_k that is not positive (initial positive sequence; Geyer 1992). It is one number
    for all runs: with one of its own, a run that fits badly would lose its weight and fit worse.
    """
    total = np.zeros(max(len(one) for one in residuals))
    for one in residuals:
        power = np.abs(np.fft.rfft(one, 2 * len(one), axis=0)) ** 2
        total[: len(one)] += np.fft.irfft(power, axis=0)[: len(one)].sum(axis=1)
    if not total[0] > 0:
        return 1.0
    rho = total[1:] / total[0]
    ends = np.flatnonzero(rho <= 0)
    return float(1 + 2 * rho[: ends[0] if len(ends) else None].sum())


def _extra(data: Sequence[Poses], gaps: Sequence[Array], stated: Sequence[Array], fitted: float) -> dict[str, float]:
    """The extra standard deviation of each kind of number, from gaps (K, D) with stated covariances (K, D, D).

    Each kind of numbers determines its part of the unknowns.
    """
    residual: dict[str, list[Array]] = {}
    covariance: dict[str, list[Array]] = {}
    total = 0
    for poses, gap, own in zip(data, gaps, stated, strict=True):
        for kind in poses.kinds:
            part = poses.columns(kind)
            known = poses.measured[:, part].all(axis=1) & np.isfinite(gap[:, part]).all(axis=1)
            residual.setdefault(kind, []).append(gap[known, part])
            covariance.setdefault(kind, []).append(own[known, part, part])
            total += 3 * int(known.sum())
    found = {}
    for kind, rows in residual.items():
        every = np.concatenate(rows)
        share = fitted * every.size / max(total, 1)
        found[kind] = extra_std(every, np.concatenate(covariance[kind]), share) if every.size else 0.0
    return found


def extra_std(residual: Array, covariance: Array, fitted: float) -> float:
    """Standard deviation per axis beyond stated covariances (K, 3, 3), in the unit of the residuals (K, 3).

    Zero unless the residuals are significantly too large; else the value for which the mean clipped square has its
    expectation.
    """
    freedom = max(residual.size - fitted, 1.0)
    values, vectors = np.linalg.eigh(covariance)
    turned2 = np.einsum("kji,kj->ki", vectors, residual) ** 2

    def excess(sigma: float) -> float:
        distance2 = (turned2 / (values + sigma**2)).sum(axis=1)
        return float(np.minimum(distance2, OUTLIER**2).sum()) / (freedom * _EXPECTED_SQUARE) - 1

    if excess(0.0) <= math.sqrt(2 / freedom) * _SIGNIFICANT:
        return 0.0
    return _MOST if excess(_MOST) > 0 else float(brentq(excess, 0.0, _MOST, xtol=1e-9))
