"""What errors of the model add to the error bars of planned experiments, by the posterior of the identification."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import Discrepancy
from calibration.identify.model_error import CoefficientPrior, lacking
from calibration.identify.model_error_posterior import effect_columns, normal_equations
from calibration.identify.model_error_sampler import PRESENT, AmplitudeSampler
from model.arrays import Array

# Sweeps of the sampler for each draw of the measurement errors; the medians are over many draws.
_SWEEPS = 60


class Effects(NamedTuple):
    """What the model lacks, as the predictions of planned experiments respond to it.

    Columns (K, D, m) of every run by the coefficients, their prior, and the scale of each term.
    """

    columns: list[Array]
    prior: CoefficientPrior
    scale: Array

    @classmethod
    def of(cls, problem: LeastSquaresProblem) -> Effects:
        """The effects at the start of a problem."""
        columns, prior = effect_columns(problem, np.zeros(len(problem.unknowns)))
        return cls(columns, prior, np.array([one.scale for one in lacking(problem.start.arm)]))


def columns_and_amplitude(problem: LeastSquaresProblem) -> tuple[list[Array], Array]:
    """Response (K, D, m) of each run's predictions to the coefficients, and their rms (m,) before data.

    With the probability that an effect is absent; see `model_error_posterior`.
    """
    columns, prior, scale = Effects.of(problem)
    return columns, np.sqrt(PRESENT) * scale[prior.term] * prior.rms


def added_variances(problem: LeastSquaresProblem, effects: Effects, draws: int, rng: np.random.Generator) -> Array:
    """Mean squares (draws, n), in spans, that the model error adds to those of the unknowns.

    For planned experiments, with tips as the start predicts them, on an arm that obeys the model: what the data say of
    the coefficients, for draws of the measurement errors (preposterior analysis, Raiffa and Schlaifer 1961).
    """
    n, z = len(problem.unknowns), np.zeros(len(problem.unknowns))
    weights, _ = problem.weights(z, 0.0)
    exact = problem.solution(z, range(n), weights, Discrepancy(0.0), True)
    # Frames without errors have a correlation that means nothing.
    solution = replace(exact, correlation=(1.0,) * len(problem.data))
    equations = normal_equations(problem, solution, np.zeros(n), effects.columns, Discrepancy(0.0))
    # The gradient of unit normal residuals has the information as its covariance.
    values, vectors = np.linalg.eigh(equations.seen)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    sampler = AmplitudeSampler([replace(equations, at_fit=np.zeros(n))], effects.prior, effects.scale, _SWEEPS)
    found = [sampler.sample([root @ drawn]).second for drawn in rng.standard_normal((draws, len(values)))]
    return np.array([np.diagonal(one)[:n] - np.diagonal(equations.inverse) for one in found])
