"""Least squares of one identification: unknowns in units of their span, residuals and slopes over all runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calibration.identify.data import Poses
from calibration.identify.likelihood import (
    Weights,
    apply_frequency_mask,
    damped,
    discrepancy,
    frequency_mask,
    score_covariance,
    whitened,
)
from calibration.identify.parameters import Parameter, Prior, Setup
from calibration.identify.tip_predictor import FINE_SUBSTEPS, SUBSTEPS, Predictor

Array = NDArray[np.float64]

# Of the model's gradients.
_STEP = 1e-7
# A faint pull to the start, in spans: it keeps what the data do not decide from drifting, and nothing else.
_TETHER = 5.0
_ROUNDS = 5
_NOTICEABLE = 0.05
_LONGEST_STEP = 1.0
_SAME_SLOPE = 3e-3
# What a squared step, in spans, costs of the sum of squares where the search begins to be careful, and where it ceases.
_CAREFUL, _CARELESS = 1.0, 1e-3
# How near a parameter may come to what it must stay below.
_SHORT_OF = 0.98
# A step that promises less than this of the sum of squares is a hundredth of an error bar.
_CONVERGED = 1e-4


@dataclass(frozen=True)
class Unknown:
    """A free parameter, or one run's own value of it, counted in spans z from its start.

    What data tell the reciprocal of is counted by that, in spans of the same size at the start.
    """

    parameter: Parameter
    run: int | None
    start: float
    span: float
    most: float

    @classmethod
    def of_setup(cls, parameter: Parameter, run: int | None, setup: Setup) -> Unknown:
        """The parameter as it is in a setup."""
        start = parameter.read(setup)
        most = min(parameter.upper, _SHORT_OF * parameter.below(setup))
        return cls(parameter, run, start, parameter.span(start), most)

    def at(self, z: float) -> float:
        """The value at z, within the parameter's bounds."""
        z = min(max(z, self.lower), self.upper)
        away = self.span * z
        value = self.start / (1 - away / self.start) if self.parameter.reciprocal else self.start + away
        return min(max(value, self.parameter.lower), self.most)

    def of(self, value: float) -> float:
        """The z of a value."""
        away = value - self.start
        return (away * self.start / value if self.parameter.reciprocal else away) / self.span

    def rate(self, z: float) -> float:
        """How fast the value goes with z."""
        return self.span * (self.at(z) / self.start) ** 2 if self.parameter.reciprocal else self.span

    @property
    def lower(self) -> float:
        """Lower bound of z."""
        return self.of(self.parameter.lower)

    @property
    def upper(self) -> float:
        """Upper bound of z."""
        return self.of(self.most)


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

    substeps: time steps per frame of a motion, by default as many as what is free needs.
    For the bootstrap: entry_weights, per run (K,), how often each entry counts (None: once), and prior_shift, by how
    many standard deviations each prior's mean is moved, in the order of the unknowns that have one.
    """

    data: Sequence[Poses]
    start: Setup
    free: Sequence[Parameter]
    priors: Mapping[str, Prior] = field(default_factory=dict)
    entry_weights: Sequence[Array] | None = None
    prior_shift: Array | None = None
    substeps: int = 0

    def __post_init__(self) -> None:
        shared = [Unknown.of_setup(p, None, self.start) for p in self.free if not p.per_run]
        own = [Unknown.of_setup(p, run, self.start) for p in self.free if p.per_run for run in range(len(self.data))]
        self.unknowns = (*shared, *own)
        fast = any(p.name in ("density_kg_m3", "damping_s", "sensor_lag_s") for p in self.free)
        self.substeps = self.substeps or (FINE_SUBSTEPS if fast else SUBSTEPS)
        self._predictors = [Predictor(poses, self.substeps) for poses in self.data]
        self._passed = [
            apply_frequency_mask(poses) if poses.moving else np.ones(len(poses) // 2 + 1) for poses in self.data
        ]
        self._pressure: tuple[Array, list[Array]] | None = None
        self._slopes: tuple[Array, tuple[int, ...], list[Array]] | None = None
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
                out = unknown.parameter.write(out, unknown.at(float(value)))
        return out

    def rates(self, z: Array) -> Array:
        """How fast the unknowns' values (n,) go with z (n,)."""
        return np.array([unknown.rate(value) for unknown, value in zip(self.unknowns, z.tolist(), strict=True)])

    def values(self, z: Array) -> Array:
        """The unknowns' values (n,) at z (n,)."""
        return np.array([unknown.at(value) for unknown, value in zip(self.unknowns, z.tolist(), strict=True)])

    def predicted(self, z: Array) -> list[Array]:
        """Tips (K, 3) of every run."""
        return [predictor(self.setup(z, run)) for run, predictor in enumerate(self._predictors)]

    def slopes(self, z: Array, only: Sequence[int]) -> list[Array]:
        """Derivatives (K, 3, n) of every run's tips by the unknowns `only`; those at the last z are kept.

        Where z has moved by less than a few thousandths of a span they are still good: they bend no faster.
        """
        if self._slopes is not None:
            there, columns, kept = self._slopes
            if set(only) <= set(columns) and np.abs(z - there).max(initial=0.0) < _SAME_SLOPE:
                chosen = [columns.index(i) for i in only]
                return [slope[:, :, chosen] for slope in kept]
        out = []
        for run, predictor in enumerate(self._predictors):
            mine = [(column, i) for column, i in enumerate(only) if i in self._columns[run]]
            moved, steps = self._moved(z, run, [i for _, i in mine])
            slope = np.zeros((len(self.data[run]), 3, len(only)))
            slope[:, :, [column for column, _ in mine]] = predictor.slopes(self.setup(z, run), moved, steps)
            out.append(np.nan_to_num(slope, nan=0.0))
        self._slopes = (z.copy(), tuple(only), out)
        return out

    def _moved(self, z: Array, run: int, which: Sequence[int]) -> tuple[list[Setup], list[float]]:
        """A run's setups with one unknown moved each, and by how much; upwards unless a bound is there."""
        steps = [-_STEP if z[i] + _STEP > self.unknowns[i].upper else _STEP for i in which]
        moved = []
        for i, own in zip(which, steps, strict=True):
            there = z.copy()
            there[i] += own
            moved.append(self.setup(there, run))
        return moved, steps

    def solve(self, z: Array, held: Sequence[int] = (), rounds: int = _ROUNDS, evaluations: int = 40) -> Solution:
        """Climb to the maximum from z (n,); `held` unknowns stay where they are. Weights are updated between rounds."""
        only = [i for i in range(len(self.unknowns)) if i not in set(held)]
        z = z.copy()
        weights, sigma = self.weights(z, len(only))
        solved, before = True, np.inf
        for _ in range(rounds):
            if only:
                z, solved = self.climb(z, only, weights, evaluations)
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
        loss, log_likelihood = 0.0, 0.0
        slopes = self.slopes(z, only)
        rows = []
        for run, poses in enumerate(self.data):
            slope = -np.einsum("kij,kjn->kin", weights[run].whitener, slopes[run])
            damp, slope_d = damped(whitened(poses, at[run], weights[run]), slope)
            assert slope_d is not None
            root = np.sqrt(self._count(run))
            rows.append((self._kept(run, damp) * root[:, None], self._kept(run, slope_d) * root[:, None, None]))
            squares = float((rows[-1][0] ** 2).sum())
            loss += squares
            log_likelihood -= 0.5 * (squares + weights[run].log_det)
        prior_rows, prior_gap = self._prior_rows(z)
        loss += float(prior_gap @ prior_gap)
        prior = prior_rows.T @ prior_rows
        information, correlation = self._counted(rows, prior, only)
        return Solution(z, information, prior, loss, log_likelihood, sigma, correlation, weights, solved)

    def _counted(
        self, rows: Sequence[tuple[Array, Array]], prior: Array, only: Sequence[int]
    ) -> tuple[Array, tuple[float, ...]]:
        """Information (n, n) of residuals and slopes, and by how much each run's entries count less than they are."""
        part = np.ix_(only, only)
        curvatures = [np.einsum("kin,kim->nm", slope, slope) for _, slope in rows]
        curvature = np.sum(curvatures, axis=0) + prior[part]
        covariance = _inverse(curvature)
        pulls, correlation = [], []
        for run, (residual, slope) in enumerate(rows):
            poses, pull = self.data[run], curvatures[run]
            if poses.in_sequence:
                pull = score_covariance(residual, slope, self._passed[run], float(poses.seen.mean()), covariance)
            told = float(np.trace(covariance @ curvatures[run]))
            pulls.append(pull)
            correlation.append(float(np.trace(covariance @ pull)) / told if told > 0 else 1.0)
        information = prior.copy()
        information[part] = _sandwich(curvature, np.sum(pulls, axis=0) + prior[part])
        return information, tuple(correlation)

    def loss(self, z: Array, weights: tuple[Weights, ...], correlation: Sequence[float]) -> float:
        """Robust sum of squares at given weights, priors included; runs count by their independent entries."""
        gap = self._prior_rows(z)[1]
        total = float(gap @ gap)
        for run, (poses, tips) in enumerate(zip(self.data, self.predicted(z), strict=True)):
            damp, _ = damped(whitened(poses, tips, weights[run]))
            total += float((self._kept(run, damp) ** 2 * self._count(run)[:, None]).sum()) / correlation[run]
        return total

    def _pressure_covariances(self, z: Array) -> list[Array]:
        """What pressure errors add, found anew only where the parameters have moved noticeably."""
        if self._pressure is None or np.abs(z - self._pressure[0]).max(initial=0.0) > _NOTICEABLE:
            found = [p.pressure_covariance(self.setup(z, run)) for run, p in enumerate(self._predictors)]
            self._pressure = (z.copy(), found)
        return self._pressure[1]

    def climb(self, z: Array, only: list[int], weights: tuple[Weights, ...], evaluations: int) -> tuple[Array, bool]:
        """Gauss and Newton's steps within the bounds, damped where the loss does not fall.

        What is damped is the step in spans (Levenberg): it shortens the way along what the data leave open, on which
        they are met less well than straight ahead seems, and leaves what they tell sharply alone. Damping by the
        curvature (Marquardt) would slow all unknowns down that can be exchanged with others.
        """
        lower, upper = (np.array([getattr(self.unknowns[i], side) for i in only]) for side in ("lower", "upper"))
        z[only] = np.clip(z[only], lower, upper)
        residual = self._rows(z, only, weights)
        damping = 0.0
        slope: Array | None = None
        for _ in range(evaluations):
            if slope is None:
                slope = self._slope_rows(z, only, weights)
            pull = -slope.T @ residual
            stuck = ((z[only] <= lower) & (pull < 0)) | ((z[only] >= upper) & (pull > 0))
            loose = np.flatnonzero(~stuck)
            curvature = (slope.T @ slope)[np.ix_(loose, loose)]
            step = np.zeros(len(only))
            step[loose] = np.linalg.solve(curvature + damping * np.eye(len(loose)), pull[loose])
            promised = float(step @ pull)
            step *= min(1.0, _LONGEST_STEP / max(np.abs(step).max(initial=0.0), 1e-300))
            trial = z.copy()
            trial[only] = np.clip(z[only] + step, lower, upper)
            there = self._rows(trial, only, weights)
            better = float(there @ there) <= float(residual @ residual)
            if better:
                z, residual, slope = trial, there, None
                damping = damping / 10 if damping > _CARELESS else 0.0
            else:
                damping = max(10 * damping, _CAREFUL)
            if promised < _CONVERGED:
                return z, True
        return z, False

    def _rows(self, z: Array, only: list[int], weights: tuple[Weights, ...]) -> Array:
        """Everything whose squares are summed: residuals, priors, tether."""
        rows = []
        for run, tips in enumerate(self.predicted(z)):
            damp, _ = damped(whitened(self.data[run], tips, weights[run]))
            rows.append((self._kept(run, damp) * np.sqrt(self._count(run))[:, None]).ravel())
        return np.concatenate([*rows, self._prior_rows(z)[1], z[only] / _TETHER])

    def _slope_rows(self, z: Array, only: list[int], weights: tuple[Weights, ...]) -> Array:
        """Derivatives of `_rows` by the unknowns `only`."""
        at = self.predicted(z)
        rows = []
        for run, tips_slope in enumerate(self.slopes(z, only)):
            turned = -np.einsum("kij,kjn->kin", weights[run].whitener, tips_slope)
            _, out = damped(whitened(self.data[run], at[run], weights[run]), turned)
            assert out is not None
            rows.append((self._kept(run, out) * np.sqrt(self._count(run))[:, None, None]).reshape(-1, len(only)))
        return np.concatenate([*rows, self._prior_rows(z)[0][:, only], np.eye(len(only)) / _TETHER])

    def _prior_rows(self, z: Array) -> tuple[Array, Array]:
        """Rows (m, n) and gaps (m,) of the priors in standard deviations."""
        rows, gaps = [], []
        for i, unknown in enumerate(self.unknowns):
            prior = self.priors.get(unknown.parameter.name)
            if prior is not None:
                row = np.zeros(len(z))
                row[i] = unknown.rate(float(z[i])) / prior.std
                rows.append(row)
                gaps.append((unknown.at(float(z[i])) - prior.mean) / prior.std)
        gap = np.array(gaps)
        return np.array(rows).reshape(-1, len(z)), gap if self.prior_shift is None else gap - self.prior_shift

    def _kept(self, run: int, rows: Array) -> Array:
        """Rows (K, ..) of a run without the frequencies that do not count."""
        return frequency_mask(rows, self._passed[run])

    def _count(self, run: int) -> Array:
        return np.ones(len(self.data[run])) if self.entry_weights is None else self.entry_weights[run]


def _roots(matrix: Array) -> tuple[Array, Array]:
    """Of a symmetric matrix (n, n) that nothing is negative in: values (k,) and vectors (n, k) of what is in it."""
    values, vectors = np.linalg.eigh(matrix)
    there = values > max(1e-12, 1e-14 * float(values.max(initial=0.0)))
    return values[there], vectors[:, there]


def _inverse(matrix: Array) -> Array:
    """Of a symmetric matrix (n, n) that nothing is negative in; along what is missing in it, zero."""
    values, vectors = _roots(matrix)
    out: Array = (vectors / values) @ vectors.T
    return out


def _sandwich(curvature: Array, pull: Array) -> Array:
    """Information (n, n) where what pulls scatters by `pull`: curvature pull^-1 curvature.

    In units of the curvature's own axes: multiplied out, what the data tell sharply would drown what they leave open.
    """
    values, vectors = _roots(curvature)
    scale = np.sqrt(values)
    relative = (vectors / scale).T @ pull @ (vectors / scale)
    wide = vectors * scale
    out: Array = wide @ _inverse(relative) @ wide.T
    return (out + out.T) / 2
