"""Posterior of the model error given the residuals of a fit, and its effect on the parameters.

Each term is present or absent. The coefficients of a term that is present are random effects with normal distributions
in proportion to the term's amplitude. Presence, amplitudes and the independent error of the tips are averaged over
their posterior distribution by Gibbs sampling (Kennedy and O'Hagan 2001 with a parametric discrepancy; George and
McCulloch 1993 for the selection of terms).

The predictions are linearised in unknowns and coefficients. So independent errors that are smaller than the error of
this linearisation are not considered: the coefficients would explain the residuals only in the linearised model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from calibration.identify.effects_problem import EffectsProblem
from calibration.identify.least_squares import RIDGE_SPANS, LeastSquaresProblem
from calibration.identify.likelihood import Discrepancy, Weights, outlying, whitened
from calibration.identify.model_error import (
    CoefficientPrior,
    ModelErrorTerm,
    error_inputs,
    lacking,
    reference_pressure_pa,
)
from calibration.identify.model_error_sampler import LEVELS, AmplitudeSampler, NormalEquations
from calibration.identify.solution import Solution
from model.arrays import Array

# Probability above which a term counts as found.
FOUND = 0.95
# Independent errors of the tips that are considered, as shares of the discrepancy of the fit.
_NOISE_SHARES = (0.05, 0.3, 0.6, 1.0)
# Smallest amplitude of a term that is stated, as a share of its scale.
_LEAST_SHARE = 1e-3


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

    mean (n + m,): of both, from the fit and zero. second (n + m, n + m): their mean squares and products; unknowns in
    spans. amplitude (m,): root mean square of the coefficients, the same for all of a term. noise_m: independent error
    of the tips. effects: one for each term. absent: probability that no term is present.
    """

    mean: Array
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


def model_error_posterior(problem: LeastSquaresProblem, solution: Solution, assumed: Array) -> ModelErrorPosterior:
    """The posterior at the solution of a fit; assumed (n,): information on unknowns that are held, in spans."""
    terms = lacking(problem.start.arm)
    columns, prior = effect_columns(problem, solution.z)
    term = prior.term
    off = solution.discrepancy
    shares: tuple[float, ...] = _NOISE_SHARES if any(off.of_kinds.values()) else (0.0,)
    equations = [normal_equations(problem, solution, assumed, columns, off.scaled(share)) for share in shares]
    scale = np.array([one.scale for one in terms])
    drawn = AmplitudeSampler(equations, prior, scale).sample()
    while len(shares) > 1 and linearisation_error(problem, solution, columns, drawn.mean, off.scaled(shares[0])) > 1:
        shares, equations = shares[1:], equations[1:]
        drawn = AmplitudeSampler(equations, prior, scale).sample()
    sizes = np.column_stack(
        [one.size(drawn.coefficients[:, term == k], problem.data[0].actuators) for k, one in enumerate(terms)]
    )
    mean_square = np.array([(drawn.coefficients[:, term == k] ** 2).mean() for k in range(len(terms))])
    return ModelErrorPosterior(
        mean=drawn.mean,
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
        own.slopes(predictor, problem.setup(z, run), np.zeros(len(own.load)))
        for run, (own, predictor) in enumerate(zip(inputs, problem.predictors(z), strict=True))
    ]
    return columns, inputs[0].prior


def linearisation_error(
    problem: LeastSquaresProblem, solution: Solution, columns: Sequence[Array], change: Array, noise: Discrepancy
) -> float:
    """Error of the linearised predictions at a change (n + m,) of unknowns and coefficients from the solution.

    Root mean square of the measured numbers, each in units of its standard deviation with this noise. Infinite where
    the model has no solution.
    """
    n, z = len(solution.z), solution.z
    lower, upper = problem.bounds(range(n))
    at = np.clip(z + change[:n], lower, upper)
    gaps, slopes, pressure = problem.gaps(z), problem.slopes(z, range(n)), problem.pressure_errors(z)
    exact = EffectsProblem(problem, np.ones(len(change) - n)).gaps(np.concatenate([at, change[n:]]))
    errors = []
    for run, poses in enumerate(problem.data):
        linear = gaps[run] - slopes[run] @ (at - z) - columns[run] @ change[n:]
        covariance = poses.pose_covariance + pressure[run].independent + noise.covariance(poses.kinds)
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        errors.append(((exact[run] - linear) / std)[poses.measured & np.isfinite(gaps[run])])
    rms = float(np.sqrt(np.mean(np.square(np.concatenate(errors)))))
    return rms if math.isfinite(rms) else math.inf


def _effect(term: ModelErrorTerm, probability: float, size: Array, present: NDArray[np.bool_]) -> Effect:
    chosen = size[present] if present.any() else np.zeros(1)
    # The smallest amplitude that is considered.
    least = float(LEVELS[1]) * term.scale
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
    on_unknowns = [prior, np.diag(np.sqrt(assumed + 1 / RIDGE_SPANS**2))]
    on_coefficients = [np.zeros((len(prior) + n, m))]
    residual = [-gap, np.zeros(n)]
    constant = 0.0
    gaps, pressure = problem.gaps(z), problem.pressure_errors(z)
    slopes = problem.slopes(z, range(n))
    for run, poses in enumerate(problem.data):
        good = poses.has_tip & ~outlying(whitened(poses, gaps[run], solution.weights[run]))
        if not good.any():
            continue
        by_pressure, measured = pressure[run], poses.measured & good[:, None]
        covariance = poses.pose_covariance + by_pressure.independent + noise.covariance(poses.kinds)
        weights = Weights.of(covariance, measured, by_pressure.common, by_pressure.motion)
        # Correlated entries count as fewer independent ones.
        share = 1 / math.sqrt(solution.correlation[run])
        own = share * weights.whitened(np.nan_to_num(gaps[run]))[good].ravel()
        on_unknowns.append(share * weights.whitened(slopes[run])[good].reshape(-1, n))
        on_coefficients.append(share * weights.whitened(columns[run])[good].reshape(-1, m))
        residual.append(own)
        constant -= 0.5 * float(own @ own) + 0.5 * weights.log_det / solution.correlation[run]
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
