"""Least squares of one identification: unknowns in units of their span, residuals and slopes over all runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibration.identify.data import Poses
from calibration.identify.likelihood import Weights, correlation_time, damped, discrepancy, whitened
from calibration.identify.parameters import Parameter, Prior, Setup
from calibration.identify.predict import Predictor

Array = NDArray[np.float64]

_STEP = 3e-5
# A faint pull to the start, in spans: it keeps what the data do not decide from drifting, and nothing else.
_TETHER = 5.0
_ROUNDS = 5
_NOTICEABLE = 0.05


@dataclass(frozen=True)
class Unknown:
    """A free parameter, or one run's own value of it."""

    parameter: Parameter
    run: int | None
    start: float
    span: float

    @property
    def lower(self) -> float:
        """Lower bound in units of the span from the start."""
        return (self.parameter.lower - self.start) / self.span

    @property
    def upper(self) -> float:
        """Upper bound in units of the span from the start."""
        return (self.parameter.upper - self.start) / self.span


@dataclass(frozen=True)
class Solution:
    """Where the likelihood is greatest. z (n,) in spans; information (n, n) of data and priors, without the tether."""

    z: Array
    information: Array
    prior_information: Array
    loss: float
    """Robust sum of squares, priors included, at the final weights."""
    log_likelihood: float
    discrepancy_m: float
    correlation: tuple[float, ...]
    weights: tuple[Weights, ...]
    solved: bool


@dataclass
class Problem:
    """Which runs, from where, what is free and what is known beforehand.

    For the bootstrap: entry_weights, per run (K,), how often each entry counts (None: once), and prior_shift, by how
    many standard deviations each prior's mean is moved, in the order of the unknowns that have one.
    """

    data: Sequence[Poses]
    start: Setup
    free: Sequence[Parameter]
    priors: Mapping[str, Prior] = field(default_factory=dict)
    entry_weights: Sequence[Array] | None = None
    prior_shift: Array | None = None

    def __post_init__(self) -> None:
        shared = [Unknown(p, None, p.read(self.start), p.span(p.read(self.start))) for p in self.free if not p.per_run]
        own = [
            Unknown(p, run, p.read(self.start), p.span(p.read(self.start)))
            for p in self.free
            if p.per_run
            for run in range(len(self.data))
        ]
        self.unknowns = (*shared, *own)
        self._predictors = [Predictor(poses) for poses in self.data]
        self._pressure: tuple[Array, list[Array]] | None = None
        self._columns = [
            [i for i, u in enumerate(self.unknowns) if u.run is None or u.run == run] for run in range(len(self.data))
        ]

    @property
    def measured(self) -> int:
        """Numbers measured: three per tip."""
        return 3 * int(sum(poses.seen.sum() for poses in self.data))

    def setup(self, z: Array, run: int | None = None) -> Setup:
        """The setup at z as run number `run` had it, or without any run's own values."""
        out = self.start
        for unknown, value in zip(self.unknowns, z, strict=True):
            if unknown.run is None or unknown.run == run:
                parameter = unknown.parameter
                x = float(np.clip(unknown.start + unknown.span * value, parameter.lower, parameter.upper))
                out = parameter.write(out, x)
        return out

    def predicted(self, z: Array) -> list[Array]:
        """Tips (K, 3) of every run."""
        return [predictor(self.setup(z, run)) for run, predictor in enumerate(self._predictors)]

    def slopes(self, z: Array, at: list[Array], only: Sequence[int]) -> list[Array]:
        """Derivatives (K, 3, n) of every run's tips by the unknowns `only`."""
        out = []
        for run, predictor in enumerate(self._predictors):
            slope = np.zeros((*at[run].shape, len(only)))
            for column, i in enumerate(only):
                if i not in self._columns[run]:
                    continue
                step = -_STEP if z[i] + _STEP > self.unknowns[i].upper else _STEP
                moved = z.copy()
                moved[i] += step
                slope[:, :, column] = (predictor(self.setup(moved, run)) - at[run]) / step
            out.append(np.nan_to_num(slope, nan=0.0))
        return out

    def solve(self, z: Array, held: Sequence[int] = (), rounds: int = _ROUNDS, evaluations: int = 40) -> Solution:
        """Climb to the maximum from z (n,); `held` unknowns stay where they are. Weights are updated between rounds."""
        only = [i for i in range(len(self.unknowns)) if i not in set(held)]
        z = z.copy()
        weights, sigma = self.weights(z, len(only))
        solved, before = True, np.inf
        for _ in range(rounds):
            if only:
                z, solved = self._climb(z, only, weights, evaluations)
            weights, sigma = self.weights(z, len(only))
            if abs(sigma - before) <= 0.02 * sigma:
                break
            before = sigma
        return self.solution(z, only, weights, sigma, solved)

    def weights(self, z: Array, fitted: int) -> tuple[tuple[Weights, ...], float]:
        """How residuals near z are weighed, and the model's discrepancy [m]."""
        predicted = self.predicted(z)
        pressure = self._pressure_covariances(z)
        covariances, residuals, seen_covariances = [], [], []
        for run, (poses, tips) in enumerate(zip(self.data, predicted, strict=True)):
            covariance = poses.covariance_m2 + pressure[run]
            known = poses.seen & np.isfinite(tips).all(axis=1)
            covariances.append(covariance)
            residuals.append((poses.tip_m - tips)[known])
            seen_covariances.append(covariance[known])
        sigma = discrepancy(residuals, seen_covariances, fitted)
        extra = sigma**2 * np.eye(3)
        return tuple(Weights.of(c + extra, p.seen) for c, p in zip(covariances, self.data, strict=True)), sigma

    def solution(
        self, z: Array, only: Sequence[int], weights: tuple[Weights, ...], sigma: float, solved: bool
    ) -> Solution:
        """What the likelihood looks like at z; `only` were fitted, and only they get information."""
        at = self.predicted(z)
        information, loss, log_likelihood, correlation = np.zeros((len(z), len(z))), 0.0, 0.0, []
        slopes = self.slopes(z, at, only)
        for run, poses in enumerate(self.data):
            residual = whitened(poses, at[run], weights[run])
            slope = -np.einsum("kij,kjn->kin", weights[run].whitener, slopes[run])
            seen = poses.seen
            time = correlation_time(residual[seen]) if poses.moving else 1.0
            correlation.append(time)
            damp, slope_d = damped(residual, slope)
            assert slope_d is not None
            count = self._count(run)
            rows = (slope_d * np.sqrt(count / time)[:, None, None]).reshape(residual.size, len(only))
            information[np.ix_(only, only)] += rows.T @ rows
            squares = float((damp**2 * count[:, None]).sum())
            loss += squares
            log_likelihood -= 0.5 * (squares + weights[run].log_det)
        prior_rows, prior_gap = self._prior_rows(z)
        loss += float(prior_gap @ prior_gap)
        prior = prior_rows.T @ prior_rows
        return Solution(z, information + prior, prior, loss, log_likelihood, sigma, tuple(correlation), weights, solved)

    def loss(self, z: Array, weights: tuple[Weights, ...], correlation: Sequence[float]) -> float:
        """Robust sum of squares at given weights, priors included; runs count by their independent entries."""
        gap = self._prior_rows(z)[1]
        total = float(gap @ gap)
        for run, poses in enumerate(self.data):
            damp, _ = damped(whitened(poses, self.predicted(z)[run], weights[run]))
            total += float((damp**2 * self._count(run)[:, None]).sum()) / correlation[run]
        return total

    def _pressure_covariances(self, z: Array) -> list[Array]:
        """What pressure errors add, found anew only where the parameters have moved noticeably."""
        if self._pressure is None or np.abs(z - self._pressure[0]).max(initial=0.0) > _NOTICEABLE:
            found = [p.pressure_covariance(self.setup(z, run)) for run, p in enumerate(self._predictors)]
            self._pressure = (z.copy(), found)
        return self._pressure[1]

    def _climb(self, z: Array, only: list[int], weights: tuple[Weights, ...], evaluations: int) -> tuple[Array, bool]:
        def whole(part: Array) -> Array:
            out = z.copy()
            out[only] = part
            return out

        def residual(part: Array) -> Array:
            now = whole(part)
            rows = []
            for run, tips in enumerate(self.predicted(now)):
                damp, _ = damped(whitened(self.data[run], tips, weights[run]))
                rows.append((damp * np.sqrt(self._count(run))[:, None]).ravel())
            return np.concatenate([*rows, self._prior_rows(now)[1], part / _TETHER])

        def slope(part: Array) -> Array:
            now = whole(part)
            at = self.predicted(now)
            rows = []
            for run, tips_slope in enumerate(self.slopes(now, at, only)):
                whitener = weights[run].whitener
                turned = -np.einsum("kij,kjn->kin", whitener, tips_slope)
                _, out = damped(whitened(self.data[run], at[run], weights[run]), turned)
                assert out is not None
                rows.append((out * np.sqrt(self._count(run))[:, None, None]).reshape(-1, len(only)))
            return np.concatenate([*rows, self._prior_rows(now)[0][:, only], np.eye(len(only)) / _TETHER])

        lower = np.array([self.unknowns[i].lower for i in only])
        upper = np.array([self.unknowns[i].upper for i in only])
        first = np.clip(z[only], lower + 1e-9, upper - 1e-9)
        found = least_squares(
            residual, first, slope, (lower, upper), xtol=1e-6, ftol=1e-7, gtol=1e-7, max_nfev=evaluations
        )
        return whole(found.x), bool(found.status > 0)

    def _prior_rows(self, z: Array) -> tuple[Array, Array]:
        """Rows (m, n) and gaps (m,) of the priors in standard deviations."""
        rows, gaps = [], []
        for i, unknown in enumerate(self.unknowns):
            prior = self.priors.get(unknown.parameter.name)
            if prior is not None:
                row = np.zeros(len(z))
                row[i] = unknown.span / prior.std
                rows.append(row)
                gaps.append((unknown.start + unknown.span * z[i] - prior.mean) / prior.std)
        gap = np.array(gaps)
        return np.array(rows).reshape(-1, len(z)), gap if self.prior_shift is None else gap - self.prior_shift

    def _count(self, run: int) -> Array:
        return np.ones(len(self.data[run])) if self.entry_weights is None else self.entry_weights[run]
