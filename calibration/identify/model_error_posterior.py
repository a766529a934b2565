"""Posterior of the model error given the residuals of a fit, and its effect on the parameters.

The coefficients of the terms are random effects with normal distributions. The amplitudes of the terms are averaged
over their posterior distribution by Monte Carlo with importance weights (Kennedy and O'Hagan 2001, with a parametric
discrepancy).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import halfnorm, qmc

from calibration.identify.least_squares import LeastSquaresProblem, Solution
from calibration.identify.likelihood import OUTLIER, Weights, whitened
from calibration.identify.model_error import TERMS, error_columns
from calibration.identify.tip_predictor import Predictor

Array = NDArray[np.float64]

# Samples of the amplitudes.
_SAMPLES = 512
# Independent errors of the tips that are considered, as shares of the discrepancy of the fit.
_NOISE_SHARES = (0.05, 0.3, 0.6, 1.0)
# Log Bayes factor from which a model error counts as found.
FOUND = math.log(20.0)
# Standard deviation, in spans, of the ridge term of the search, and of unknowns that are held as undetermined.
_RIDGE_SPANS, _HELD_SPANS = 5.0, 0.5


@dataclass(frozen=True)
class ModelErrorPosterior:
    """Posterior of the errors of the fitted unknowns and of the coefficients of the model error, together.

    second (n + m, n + m): mean squares and products of both, about the fit and zero; unknowns in spans. noise_m:
    independent error of the tips. amplitudes: root mean square amplitude of each term, by its name. log_bayes_factor:
    evidence for a model error of this kind.
    """

    second: Array
    noise_m: float
    reference_pa: float
    amplitudes: dict[str, float]
    log_bayes_factor: float

    @property
    def found(self) -> bool:
        """Whether the residuals show a model error."""
        return self.log_bayes_factor > FOUND


@dataclass(frozen=True)
class _Normal:
    """Normal equations of unknowns d and coefficients c: sums of squares, marginal over d."""

    inverse: Array
    at_fit: Array
    """Best d without a model error (n,)."""
    absorbed: Array
    """Change of d by c, with the opposite sign (n, m)."""
    seen: Array
    """Information on c (m, m)."""
    gradient: Array
    constant: float


def model_error_posterior(
    problem: LeastSquaresProblem, solution: Solution, fixed: Collection[int]
) -> ModelErrorPosterior:
    """The posterior at the solution of a fit whose unknowns `fixed` are held."""
    reference_pa = max(float(np.abs(poses.pressure_pa).max()) for poses in problem.data) or 1.0
    columns = [
        error_columns(poses, Predictor(poses).push_response(problem.setup(solution.z, run)), reference_pa)
        for run, poses in enumerate(problem.data)
    ]
    term = columns[0].term
    noises = [share * solution.discrepancy_m for share in _NOISE_SHARES] if solution.discrepancy_m else [0.0]
    equations = [_normal(problem, solution, fixed, [c.tip_m for c in columns], noise) for noise in noises]
    unit = qmc.Sobol(len(TERMS), seed=0).random(_SAMPLES)
    drawn = np.array([one.scale for one in TERMS]) * _half_normal(unit)
    amplitudes = drawn[:, term]
    logs, means, squares = zip(*(_coefficients(one, amplitudes) for one in equations), strict=True)
    weights = np.exp(np.array(logs) - logsumexp(np.array(logs)))
    n, m = len(solution.z), len(term)
    second = np.zeros((n + m, n + m))
    for one, weight, mean, square in zip(equations, weights, means, squares, strict=True):
        c, cc, total = weight @ mean, np.einsum("s,skl->kl", weight, square), weight.sum()
        u, a = one.at_fit, one.absorbed
        crossed = np.outer(u, c) - a @ cc
        second[:n, :n] += total * (one.inverse + np.outer(u, u)) - np.outer(u, a @ c) - np.outer(a @ c, u)
        second[:n, :n] += a @ cc @ a.T
        second[:n, n:] += crossed
        second[n:, :n] += crossed.T
        second[n:, n:] += cc
    without = logsumexp([one.constant for one in equations])
    return ModelErrorPosterior(
        second=second,
        noise_m=float(np.sqrt(weights.sum(axis=1) @ np.square(noises))),
        reference_pa=reference_pa,
        amplitudes={one.name: float(np.sqrt(weights.sum(axis=0) @ drawn[:, k] ** 2)) for k, one in enumerate(TERMS)},
        log_bayes_factor=float(logsumexp(np.array(logs)) - math.log(_SAMPLES) - without),
    )


def _half_normal(unit: Array) -> Array:
    """Half-normal quantiles."""
    out: Array = halfnorm.ppf(np.clip(unit, 1e-6, 1 - 1e-6))
    return out


def _normal(
    problem: LeastSquaresProblem, solution: Solution, fixed: Collection[int], columns: Sequence[Array], noise_m: float
) -> _Normal:
    n, z = len(solution.z), solution.z
    rows, gap = problem.prior_rows(z)
    held = np.array([1 / _HELD_SPANS**2 if i in fixed else 0.0 for i in range(n)])
    information = rows.T @ rows + np.diag(held + 1 / _RIDGE_SPANS**2)
    g = -rows.T @ gap
    m = columns[0].shape[2]
    cross, seen, b, constant = np.zeros((n, m)), np.zeros((m, m)), np.zeros(m), 0.0
    predicted, pressure = problem.predicted(z), problem.pressure_covariances(z)
    slopes = problem.slopes(z, range(n))
    for run, poses in enumerate(problem.data):
        usual = whitened(poses, predicted[run], solution.weights[run])
        good = poses.has_tip & (np.linalg.norm(usual, axis=1) <= OUTLIER)
        if not good.any():
            continue
        weights = Weights.of(poses.covariance_m2 + pressure[run] + noise_m**2 * np.eye(3), good)
        # Correlated entries count as fewer independent ones.
        whitener = weights.whitener[good] / math.sqrt(max(solution.correlation[run], 1.0))
        own = np.einsum("kij,kj->ki", whitener, (poses.tip_m - predicted[run])[good]).ravel()
        jacobian = np.einsum("kij,kjn->kin", whitener, slopes[run][good]).reshape(-1, n)
        effect = np.einsum("kij,kjn->kin", whitener, columns[run][good]).reshape(-1, m)
        information += jacobian.T @ jacobian
        cross += jacobian.T @ effect
        seen += effect.T @ effect
        g += jacobian.T @ own
        b += effect.T @ own
        constant -= 0.5 * float(own @ own) + 0.5 * weights.log_det / max(solution.correlation[run], 1.0)
    inverse = np.asarray(np.linalg.inv(information), np.float64)
    absorbed, at_fit = inverse @ cross, inverse @ g
    constant += 0.5 * float(g @ at_fit) - 0.5 * float(np.linalg.slogdet(information)[1])
    return _Normal(inverse, at_fit, absorbed, seen - cross.T @ absorbed, b - cross.T @ at_fit, constant)


def _coefficients(equations: _Normal, amplitudes: Array) -> tuple[Array, Array, Array]:
    """Log evidence (S,), mean (S, m) and mean products (S, m, m) of the coefficients for amplitudes (S, m) of them."""
    m = amplitudes.shape[1]
    scaled = np.eye(m) + amplitudes[:, :, None] * equations.seen * amplitudes[:, None, :]
    covariance = amplitudes[:, :, None] * np.linalg.inv(scaled) * amplitudes[:, None, :]
    mean = covariance @ equations.gradient
    log = equations.constant - 0.5 * np.linalg.slogdet(scaled)[1] + 0.5 * mean @ equations.gradient
    return log, mean, covariance + mean[:, :, None] * mean[:, None, :]
