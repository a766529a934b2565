"""What errors of the model add to the error bars of planned experiments, by the posterior of the identification."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import Discrepancy
from calibration.identify.model_error import columns_of, lacking
from calibration.identify.model_error_posterior import PRESENT, normal_equations, sample

Array = NDArray[np.float64]

# Draws of the measurement errors that the expectation is the mean of. Their seed is fixed.
_DRAWS = 24


def columns_and_amplitude(problem: LeastSquaresProblem) -> tuple[list[Array], Array]:
    """Response (K, D, m) of each run's predictions to the coefficients, and their standard deviations (m,) before data.

    With the probability that an effect is absent; see `model_error_posterior`.
    """
    z = np.zeros(len(problem.unknowns))
    columns = columns_of(problem.data, problem.start.arm, lambda run: problem.setup(z, run))
    scale = np.array([one.scale for one in lacking(problem.start.arm)])
    return [one.pose for one in columns], np.sqrt(PRESENT) * scale[columns[0].term]


def added_covariance(problem: LeastSquaresProblem) -> Array:
    """Expected mean squares and products (n, n), in spans, that the model error adds to those of the unknowns.

    For planned experiments, with tips as the start predicts them, on an arm that obeys the model: mean over draws of
    what the data say of the coefficients (preposterior analysis, Raiffa and Schlaifer 1961).
    """
    n, z = len(problem.unknowns), np.zeros(len(problem.unknowns))
    weights, _ = problem.weights(z, 0.0)
    exact = problem.solution(z, range(n), weights, Discrepancy(0.0), True)
    # Frames without errors have a correlation that means nothing.
    solution = replace(exact, correlation=(1.0,) * len(problem.data))
    columns = columns_of(problem.data, problem.start.arm, lambda run: problem.setup(z, run))
    scale = np.array([one.scale for one in lacking(problem.start.arm)])
    equations = normal_equations(problem, solution, np.zeros(n), [one.pose for one in columns], Discrepancy(0.0))
    # The gradient of unit normal residuals has the information as its covariance.
    values, vectors = np.linalg.eigh(equations.seen)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    added = np.zeros((n, n))
    for drawn in np.random.default_rng(0).standard_normal((_DRAWS, len(values))):
        one = replace(equations, at_fit=np.zeros(n), gradient=root @ drawn)
        added += (sample([one], columns[0].term, scale).second[:n, :n] - equations.inverse) / _DRAWS
    return added
