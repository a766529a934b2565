"""Posterior of the model error given the residuals of a fit, and its effect on the parameters.

Each term is present or absent. The coefficients of a term that is present are random effects with normal distributions
in proportion to the term's amplitude. Presence, amplitudes and the independent error of the tips are
averaged over their posterior distribution by Gibbs sampling (Kennedy and O'Hagan 2001 with a parametric discrepancy;
George and McCulloch 1993 for the selection of terms).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import ndtri

from calibration.identify.least_squares import LeastSquaresProblem, Solution
from calibration.identify.likelihood import Discrepancy, Weights, outlying, whitened
from calibration.identify.model_error import (
    CoefficientPrior,
    ModelErrorTerm,
    error_inputs,
    lacking,
    reference_pressure_pa,
)

Array = NDArray[np.float64]

# Probability that a term is present before anything is known of this arm.
PRESENT = 0.5
# Probability above which a term counts as found.
FOUND = 0.95
# Amplitudes of a term that is present: these quantiles of a half-normal distribution, all equally probable.
_QUANTILES = (np.arange(6) + 0.5) / 6
# Sweeps of the sampler, and those before them that do not count.
_SWEEPS, _BURN_IN = 200, 30
# Independent errors of the tips that are considered, as shares of the discrepancy of the fit.
_NOISE_SHARES = (0.05, 0.3, 0.6, 1.0)
# Smallest amplitude of a term that is stated, as a share of its scale.
_LEAST_SHARE = 1e-3
# Standard deviation, in spans, of the ridge term of the search.
_RIDGE_SPANS = 5.0


@dataclass(frozen=True)
class Effect:
    """What the residuals say of one term: how probable it is, and its size.

    mean, std: size (see `ModelErrorTerm.size`) if the effect is present. below: 95 % bound of the size.
    """

    term: ModelErrorTerm
    probability: float
    mean: float
    std: float
    below: float

    @property
    def found(self) -> bool:
        """Whether the residuals show this effect."""
        return self.probability > FOUND


@dataclass(frozen=True)
class ModelErrorPosterior:
    """Posterior of the errors of the fitted unknowns and of the coefficients of the model error, together.

    second (n + m, n + m): mean squares and products of both, about the fit and zero; unknowns in spans. amplitude
    (m,): root mean square of the coefficients, the same for all of a term. noise_m: independent error of the tips.
    effects: one for each term. absent: probability that no term is present.
    """

    second: Array
    amplitude: Array
    noise_m: float
    reference_pa: float
    effects: tuple[Effect, ...]
    absent: float

    unknowns: int
    """Number n of the unknowns."""

    @property
    def of_unknowns(self) -> Array:
        """The part (n, n) of `second` of the unknowns."""
        return self.second[: self.unknowns, : self.unknowns]

    @property
    def found(self) -> tuple[Effect, ...]:
        """The effects that the residuals show."""
        return tuple(one for one in self.effects if one.found)


@dataclass(frozen=True)
class NormalEquations:
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


def model_error_posterior(problem: LeastSquaresProblem, solution: Solution, assumed: Array) -> ModelErrorPosterior:
    """The posterior at the solution of a fit; assumed (n,): information on unknowns that are held, in spans."""
    terms = lacking(problem.start.arm)
    columns, prior = effect_columns(problem, solution.z)
    term = prior.term
    off = solution.discrepancy
    shares = _NOISE_SHARES if any(off.of_kinds.values()) else (0.0,)
    noises = [off.scaled(share) for share in shares]
    equations = [normal_equations(problem, solution, assumed, columns, noise) for noise in noises]
    scale = np.array([one.scale for one in terms])
    drawn = sample(equations, prior, scale)
    sizes = np.column_stack(
        [one.size(drawn.coefficients[:, term == k], problem.data[0].actuators) for k, one in enumerate(terms)]
    )
    mean_square = np.array([(drawn.coefficients[:, term == k] ** 2).mean() for k in range(len(terms))])
    return ModelErrorPosterior(
        second=drawn.second,
        amplitude=np.sqrt(np.maximum(mean_square, (_LEAST_SHARE * scale) ** 2))[term],
        noise_m=off.tip_m * float(np.sqrt(np.mean(np.square(shares)[drawn.noise]))),
        reference_pa=reference_pressure_pa(problem.data),
        effects=tuple(
            _effect(one, float(drawn.probability[k]), sizes[:, k], drawn.present[:, k]) for k, one in enumerate(terms)
        ),
        absent=drawn.absent,
        unknowns=len(solution.z),
    )


def effect_columns(problem: LeastSquaresProblem, z: Array) -> tuple[list[Array], CoefficientPrior]:
    """Derivatives (K, D, m) of each run's predictions by the coefficients at z (n,), and their prior."""
    terms, reference_pa = lacking(problem.start.arm), reference_pressure_pa(problem.data)
    inputs = [error_inputs(poses, reference_pa, terms) for poses in problem.data]
    columns = [
        own.columns(predictor.push_response(problem.setup(z, run)))
        for run, (own, predictor) in enumerate(zip(inputs, problem.predictors(z), strict=True))
    ]
    return columns, inputs[0].prior


def _effect(term: ModelErrorTerm, probability: float, size: Array, present: NDArray[np.bool_]) -> Effect:
    chosen = size[present] if present.any() else np.zeros(1)
    # The smallest amplitude that is considered.
    least = float(ndtri(0.5 + 0.5 * _QUANTILES[0])) * term.scale
    return Effect(
        term, probability, float(chosen.mean()), float(chosen.std()), max(least, float(np.quantile(size, 0.95)))
    )


def normal_equations(
    problem: LeastSquaresProblem,
    solution: Solution,
    assumed: Array,
    columns: Sequence[Array],
    noise: Discrepancy,
) -> NormalEquations:
    n, z = len(solution.z), solution.z
    prior, gap = problem.prior_rows(z)
    m = columns[0].shape[2]
    on_unknowns = [prior, np.diag(np.sqrt(assumed + 1 / _RIDGE_SPANS**2))]
    on_coefficients = [np.zeros((len(prior) + n, m))]
    residual = [-gap, np.zeros(n)]
    constant = 0.0
    gaps, pressure = problem.gaps(z), problem.pressure_covariances(z)
    slopes = problem.slopes(z, range(n))
    for run, poses in enumerate(problem.data):
        good = poses.has_tip & ~outlying(whitened(poses, gaps[run], solution.weights[run]))
        if not good.any():
            continue
        covariance = poses.pose_covariance + pressure[run] + noise.covariance(poses.kinds)
        weights = Weights.of(covariance, poses.measured & good[:, None])
        # Correlated entries count as fewer independent ones.
        whitener = weights.whitener[good] / math.sqrt(max(solution.correlation[run], 1.0))
        own = np.einsum("kij,kj->ki", whitener, np.nan_to_num(gaps[run][good])).ravel()
        on_unknowns.append(np.einsum("kij,kjn->kin", whitener, slopes[run][good]).reshape(-1, n))
        on_coefficients.append(np.einsum("kij,kjn->kin", whitener, columns[run][good]).reshape(-1, m))
        residual.append(own)
        constant -= 0.5 * float(own @ own) + 0.5 * weights.log_det / max(solution.correlation[run], 1.0)
    effect, rows = np.concatenate(on_coefficients), np.concatenate(residual)
    # Orthogonal projection, not products of the columns: where the data leave unknowns open, these lose the digits that
    # decide what is left for the coefficients.
    basis, triangle = np.linalg.qr(np.concatenate(on_unknowns))
    onto_effect, onto_rows = basis.T @ effect, basis.T @ rows
    rest = effect - basis @ onto_effect
    rest -= basis @ (basis.T @ rest)
    root = solve_triangular(triangle, np.eye(n))
    constant += 0.5 * float(onto_rows @ onto_rows) - float(np.log(np.abs(np.diagonal(triangle))).sum())
    return NormalEquations(root @ root.T, root @ onto_rows, root @ onto_effect, rest.T @ rest, rest.T @ rows, constant)


@dataclass(frozen=True)
class Sampled:
    """Samples of the model error: coefficients (S, m), present (S, terms), noise (S,) as its number.

    second (n + m, n + m): as of `ModelErrorPosterior`. probability (terms,) of presence; absent: that of no term.
    """

    second: Array
    coefficients: Array
    present: NDArray[np.bool_]
    noise: NDArray[np.intp]
    probability: Array
    absent: float


def sample(
    equations: Sequence[NormalEquations], prior: CoefficientPrior, scale: Array, sweeps: int = _SWEEPS
) -> Sampled:
    """Gibbs samples given the normal equations for each noise, the prior of the m coefficients, and scale (terms,).

    Each sweep draws the amplitude of each term given the others (zero: absent), and the noise; the coefficients are
    integrated out. The seed is fixed.
    """
    rng = np.random.default_rng(0)
    term = prior.term
    count, m = len(scale), len(term)
    n = len(equations[0].at_fit)
    levels = np.concatenate([[0.0], ndtri(0.5 + 0.5 * _QUANTILES)])
    chances = np.log(np.concatenate([[1 - PRESENT], np.full(len(_QUANTILES), PRESENT / len(_QUANTILES))]))
    level, noise = [0] * count, len(equations) - 1
    second, probability, absent = np.zeros((n + m, n + m)), np.zeros(count), 0.0
    coefficients, present, noises = [], [], []

    def amplitude(level: tuple[int, ...]) -> Array:
        out: Array = (scale * levels[list(level)])[term]
        return out

    # The sampler returns to few states again and again.
    @cache
    def level_chance(k: int, others: tuple[int, ...], noise: int) -> Array:
        trial = np.tile(amplitude(others), (len(levels), 1))
        trial[:, term == k] = (scale[k] * levels)[:, None]
        return _normalised(log_evidence(equations[noise], trial * prior.std, trial * prior.mean) + chances)

    @cache
    def noise_chance(level: tuple[int, ...]) -> Array:
        own = amplitude(level)[None]
        return _normalised(np.array([log_evidence(one, own * prior.std, own * prior.mean)[0] for one in equations]))

    @cache
    def given(level: tuple[int, ...], noise: int) -> tuple[Array, Array, Array]:
        own = amplitude(level)
        mean, root = coefficients_given(equations[noise], own * prior.std, own * prior.mean)
        return mean, root, _second(equations[noise], mean, root)

    for sweep in range(-_BURN_IN, sweeps):
        for k in range(count):
            level[k] = 0
            chance = level_chance(k, tuple(level), noise)
            if sweep >= 0:
                probability[k] += (1 - chance[0]) / sweeps
                absent += chance[0] / (count * sweeps) if not any(level) else 0.0
            level[k] = int(rng.choice(len(levels), p=chance))
        if len(equations) > 1:
            chance = noise_chance(tuple(level))
            noise = int(rng.choice(len(equations), p=chance))
        if sweep >= 0:
            mean, root, own_second = given(tuple(level), noise)
            second += own_second / sweeps
            coefficients.append(mean + root @ rng.standard_normal(m))
            present.append([one > 0 for one in level])
            noises.append(noise)
    return Sampled(second, np.array(coefficients), np.array(present), np.array(noises), probability, absent)


def _normalised(log: Array) -> Array:
    chance = np.exp(log - log.max())
    out: Array = chance / chance.sum()
    return out


def log_evidence(equations: NormalEquations, deviations: Array, means: Array) -> Array:
    """Log evidence (S,) for prior standard deviations and means (S, m) of the coefficients, up to a common constant."""
    scaled = np.eye(deviations.shape[1]) + deviations[:, :, None] * equations.seen * deviations[:, None, :]
    lower = np.linalg.cholesky(scaled)
    known = means @ equations.seen
    pulled = np.linalg.solve(lower, (deviations * (equations.gradient - known))[:, :, None])[:, :, 0]
    log_root = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
    at_means = (means * (equations.gradient - 0.5 * known)).sum(axis=1)
    out: Array = equations.constant + at_means - log_root + 0.5 * (pulled**2).sum(axis=1)
    return out


def coefficients_given(equations: NormalEquations, deviation: Array, mean: Array) -> tuple[Array, Array]:
    """Mean (m,) of the coefficients with prior standard deviations and means (m,), and a root (m, m) of their
    covariance."""
    scaled = np.eye(len(deviation)) + deviation[:, None] * equations.seen * deviation
    root: Array = deviation[:, None] * np.linalg.inv(np.linalg.cholesky(scaled)).T
    return mean + root @ (root.T @ (equations.gradient - equations.seen @ mean)), root


def _second(equations: NormalEquations, mean: Array, root: Array) -> Array:
    """Mean squares and products (n + m, n + m) of unknowns and coefficients; root: of the coefficients' covariance."""
    absorbed = equations.absorbed
    centre = np.concatenate([equations.at_fit - absorbed @ mean, mean])
    spread = np.concatenate([-absorbed @ root, root])
    out: Array = np.outer(centre, centre) + spread @ spread.T
    n = len(equations.at_fit)
    out[:n, :n] += equations.inverse
    return out
