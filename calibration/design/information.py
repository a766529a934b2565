"""Fisher information of planned experiments, with the noise model, priors and unknowns of the identification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.identify.information import covariance
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.parameters import Parameter, Prior
from calibration.identify.poses import Poses
from calibration.identify.setup import Setup
from calibration.identify.tip_predictor import Predictor
from calibration.identify.undetermined import UNDETERMINED_SPANS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Unknowns:
    """What an identification would estimate: free and nuisance parameters, their priors by name, initial setup."""

    start: Setup
    free: tuple[Parameter, ...]
    nuisance: tuple[Parameter, ...]
    priors: Mapping[str, Prior]

    def problem(self, planned: Sequence[Poses], substeps: int = 0) -> LeastSquaresProblem:
        """The least-squares problem of planned experiments whose tips are exactly where the model predicts them."""
        data = [replace(poses, tip_m=Predictor(poses)(self.start)) for poses in planned]
        return LeastSquaresProblem(data, self.start, (*self.free, *self.nuisance), self.priors, substeps=substeps)


@dataclass(frozen=True)
class ErrorBars:
    """Expected standard errors: names (n,) of the shared free parameters, units, values, spans, covariance (n, n)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    spans: Array
    covariance: Array

    @property
    def std(self) -> Array:
        """Standard errors (n,), in the units of the parameters."""
        out: Array = np.sqrt(np.diagonal(self.covariance))
        return out

    @property
    def decided(self) -> NDArray[np.bool_]:
        """Which parameters (n,) an identification would state, rather than report as not identifiable."""
        out: NDArray[np.bool_] = self.std <= UNDETERMINED_SPANS * self.spans
        return out

    @property
    def correlation(self) -> Array:
        """Correlation coefficients (n, n)."""
        out: Array = self.covariance / np.outer(self.std, self.std)
        return out


def of_interest(problem: LeastSquaresProblem, unknowns: Unknowns) -> list[int]:
    """Indices of the unknowns whose error bars a design minimises: free, and shared by all runs."""
    names = {parameter.name for parameter in unknowns.free}
    return [i for i, one in enumerate(problem.unknowns) if one.run is None and one.parameter.name in names]


def block_information(problem: LeastSquaresProblem, frames: Sequence[slice]) -> tuple[Array, Array]:
    """Information (B, n, n) of ranges of frames of the problem's only run, in spans, and that of the priors (n, n)."""
    (rows,), prior = problem.whitened_slopes(np.zeros(len(problem.unknowns)), masked=False)
    return np.array([np.einsum("kin,kim->nm", rows[one], rows[one]) for one in frames]), prior.T @ prior


def error_bars(planned: Sequence[Poses], unknowns: Unknowns) -> ErrorBars:
    """Expected standard errors (Cramer-Rao bound) of an identification from all the planned experiments together."""
    problem = unknowns.problem(planned)
    rows, prior = problem.whitened_slopes(np.zeros(len(problem.unknowns)))
    data = np.sum([np.einsum("kin,kim->nm", own, own) for own in rows], axis=0)
    return bars_of(problem, unknowns, prior.T @ prior + data)


def bars_of(problem: LeastSquaresProblem, unknowns: Unknowns, information: Array) -> ErrorBars:
    """Standard errors of the parameters of interest by the information (n, n) of data and priors, in spans."""
    z = np.zeros(len(problem.unknowns))
    chosen = of_interest(problem, unknowns)
    rates = problem.rates(z)
    scaled = covariance(information) * np.outer(rates, rates)
    return ErrorBars(
        tuple(problem.unknowns[i].parameter.name for i in chosen),
        tuple(problem.unknowns[i].parameter.unit for i in chosen),
        problem.values(z)[chosen],
        np.array([problem.unknowns[i].span for i in chosen]),
        scaled[np.ix_(chosen, chosen)],
    )
