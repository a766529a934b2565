"""Information of planned experiments, with the noise model, priors, unknowns and model error of the identification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from calibration.design.expected_model_error import Effects, added_variances, columns_and_amplitude
from calibration.identify.information import covariance
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.parameter import Parameter, Prior
from calibration.identify.poses import Poses
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import located, scaled_errors
from calibration.identify.undetermined import UNDETERMINED_SPANS
from model.arrays import Array
from model.processors import usable_processors

# Draws of the measurement errors that the expected error bars are medians over. Their seed is fixed.
_DRAWS = 25
# Time steps per frame. A gradient needs fewer than the tips of a fit: twice as many change no bar of `mock` by 2 %.
SUBSTEPS = 4


@dataclass(frozen=True)
class Unknowns:
    """What an identification would estimate: free and nuisance parameters, their priors by name, initial setup.

    arms: setups that the experiment may meet, as likely as each other; the initial one if there are none.
    """

    start: Setup
    free: tuple[Parameter, ...]
    nuisance: tuple[Parameter, ...]
    priors: Mapping[str, Prior]
    arms: tuple[Setup, ...] = ()

    def problem(self, planned: Sequence[Poses]) -> LeastSquaresProblem:
        """The least-squares problem of planned experiments whose tips are exactly where the model predicts them."""
        problem = LeastSquaresProblem(planned, self.start, (*self.free, *self.nuisance), self.priors, substeps=SUBSTEPS)
        z = np.zeros(len(problem.unknowns))
        # The gradients bring the tips with them.
        problem.slopes(z, range(len(z)))
        predicted = zip(planned, problem.predicted(z), problem.rotations(z), problem.sections(z), strict=True)
        return problem.measured_as([located(poses, (tips, turned), along) for poses, tips, turned, along in predicted])


@dataclass(frozen=True)
class ErrorBars:
    """Expected standard errors `std` (n,), with names, units, values and spans, of the shared free parameters.

    alone (n,): the part by measurement and priors, without the model error. by_arm (arms, n): std of each arm, of which
    `std` is the median: fine measurements make it depend on the arm.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    spans: Array
    std: Array
    alone: Array
    by_arm: Array

    @property
    def decided(self) -> NDArray[np.bool_]:
        """Which parameters (n,) an identification would state, rather than report as not identifiable."""
        out: NDArray[np.bool_] = self.alone <= UNDETERMINED_SPANS * self.spans
        return out


def of_interest(problem: LeastSquaresProblem, unknowns: Unknowns) -> list[int]:
    """Indices of the unknowns whose error bars a design minimises: free, and shared by all runs."""
    names = {parameter.name for parameter in unknowns.free}
    return [i for i, one in enumerate(problem.unknowns) if one.run is None and one.parameter.name in names]


def block_information(problem: LeastSquaresProblem, frames: Sequence[slice]) -> tuple[Array, Array]:
    """Information (B, n + m, n + m) of ranges of frames of the problem's only run, and of the priors (n + m, n + m).

    On n unknowns, in spans, and on m coefficients of the model error.
    """
    z = np.zeros(len(problem.unknowns))
    (rows,), prior = problem.whitened_slopes(z, masked=False)
    (weights,), _ = problem.weights(z, 0.0)
    (columns,), amplitude = columns_and_amplitude(problem)
    every = np.concatenate([rows, weights.whitened(columns)], axis=2)
    information = np.array([np.einsum("kin,kim->nm", every[one], every[one], optimize=True) for one in frames])
    return information, block_diag(prior.T @ prior, np.diag(amplitude**-2))


def error_bars(planned: Sequence[Poses], unknowns: Unknowns) -> ErrorBars:
    """Expected standard errors of an identification from all the planned experiments together.

    Those of measurement and priors (Cramer-Rao bound), and what the model error adds on an arm that obeys the model.
    Medians over the arms of the unknowns, and over draws of the measurement errors.
    """
    return error_bars_of_repeats(planned, unknowns, (1.0,))[0]


def error_bars_of_repeats(
    planned: Sequence[Poses], unknowns: Unknowns, repeats: Sequence[float]
) -> tuple[ErrorBars, ...]:
    """As `error_bars`, for each number of repeats of the planned experiments."""
    arms = unknowns.arms or (unknowns.start,)
    draws = -(-_DRAWS // len(arms))

    def of_arm(arm: Setup, seed: int) -> list[tuple[Array, Array]]:
        rng = np.random.default_rng(seed)
        problem = replace(unknowns, start=arm).problem(planned)
        effects = Effects.of(problem)
        return [_bars(problem, effects, count, draws, rng) for count in repeats]

    # The kernels of the rod model release the interpreter.
    with ThreadPoolExecutor(max_workers=min(len(arms), usable_processors())) as pool:
        found = list(pool.map(of_arm, arms, range(len(arms))))
    problem = unknowns.problem([])
    chosen = [i for i, one in enumerate(problem.unknowns) if one.parameter in unknowns.free]
    names = tuple(problem.unknowns[i].parameter.name for i in chosen)
    units = tuple(problem.unknowns[i].parameter.unit for i in chosen)
    values = problem.values(np.zeros(len(problem.unknowns)))[chosen]
    spans = np.array([problem.unknowns[i].span for i in chosen])
    out = []
    for own in zip(*found, strict=True):
        alone, whole = np.array([one for one, _ in own]), np.concatenate([both for _, both in own])
        by_arm = np.array([np.median(both, axis=0)[chosen] for _, both in own])
        std, without = np.median(whole, axis=0)[chosen], np.median(alone, axis=0)[chosen]
        out.append(ErrorBars(names, units, values, spans, std, without, by_arm))
    return tuple(out)


def _bars(
    problem: LeastSquaresProblem, effects: Effects, repeats: float, draws: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Standard errors of all unknowns: alone (n,), and with the model error for each draw (draws, n)."""
    z = np.zeros(len(problem.unknowns))
    problem = problem.measured_as([_repeated(own, repeats) for own in problem.data])
    rows, prior = problem.whitened_slopes(z)
    data = np.sum([np.einsum("kin,kim->nm", own, own, optimize=True) for own in rows], axis=0)
    variances = np.diagonal(covariance(prior.T @ prior + data))
    rates = np.abs(problem.rates(z))
    return rates * np.sqrt(variances), rates * np.sqrt(variances + added_variances(problem, effects, draws, rng))


def _repeated(planned: Poses, count: float) -> Poses:
    """An experiment that is the mean of so many repeats."""
    mean = scaled_errors(planned, np.full(len(planned), 1 / count))
    return replace(mean, pressure_std_pa=planned.pressure_std_pa / np.sqrt(count))
