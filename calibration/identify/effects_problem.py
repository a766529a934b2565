"""The least-squares problem with the effects that the model lacks as further unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import Weights
from calibration.identify.model_error import columns_of
from calibration.identify.setup import Setup

Array = NDArray[np.float64]


class EffectsProblem(LeastSquaresProblem):
    """A least-squares problem whose z (n + m,) holds the unknowns, then the coefficients of the model error.

    amplitude (m,): standard deviations of the normal priors of the coefficients, about zero. The predictions are linear
    in the coefficients; their slopes are those at the beginning of each search for the minimum.
    """

    def __init__(self, problem: LeastSquaresProblem, amplitude: Array) -> None:
        super().__init__(problem.data, problem.start, problem.free, problem.priors, substeps=problem.substeps)
        self._amplitude = amplitude
        self._by_coefficients = [np.zeros((len(one), one.numbers, len(amplitude))) for one in self.data]

    def extended(self, z: Array) -> Array:
        """The unknowns z (n,) with coefficients of zero."""
        return np.concatenate([z, np.zeros(len(self._amplitude))])

    def setup(self, z: Array, run: int | None = None) -> Setup:
        """The setup at z (n + m,), without the effects."""
        return super().setup(self._split(z)[0], run)

    def gaps(self, z: Array) -> list[Array]:
        """Measured minus predicted (K, D) of every run, with the effects."""
        unknowns, coefficients = self._split(z)
        return [
            gap - own @ coefficients for gap, own in zip(super().gaps(unknowns), self._by_coefficients, strict=True)
        ]

    def slopes(self, z: Array, only: Sequence[int]) -> list[Array]:
        """Derivatives (K, D, n) of every run's predictions by the unknowns and coefficients `only`, in this order."""
        n = len(self.unknowns)
        by_unknowns = super().slopes(self._split(z)[0], [i for i in only if i < n])
        chosen = [i - n for i in only if i >= n]
        return [
            np.concatenate([one, own[:, :, chosen]], axis=2)
            for one, own in zip(by_unknowns, self._by_coefficients, strict=True)
        ]

    def prior_rows(self, z: Array) -> tuple[Array, Array]:
        """Rows (k, n + m) and gaps (k,) of the priors of unknowns and coefficients, in standard deviations."""
        unknowns, coefficients = self._split(z)
        rows, gaps = super().prior_rows(unknowns)
        return block_diag(rows, np.diag(1 / self._amplitude)), np.concatenate([gaps, coefficients / self._amplitude])

    def pressure_covariances(self, z: Array) -> list[Array]:
        """Covariances (K, D, D) by pressure errors, per run."""
        return super().pressure_covariances(self._split(z)[0])

    def without_prior(self, only: Sequence[int]) -> int:
        """Number of the unknowns `only` that have no prior; coefficients have one."""
        return super().without_prior([i for i in only if i < len(self.unknowns)])

    def bounds(self, only: Sequence[int]) -> tuple[Array, Array]:
        """Lower and upper bounds of the unknowns and coefficients `only`; coefficients have none."""
        free = np.full(sum(i >= len(self.unknowns) for i in only), np.inf)
        lower, upper = super().bounds([i for i in only if i < len(self.unknowns)])
        return np.concatenate([lower, -free]), np.concatenate([upper, free])

    def gauss_newton(
        self, z: Array, only: list[int], weights: tuple[Weights, ...], evaluations: int
    ) -> tuple[Array, bool]:
        """The minimum over unknowns and coefficients `only` at given weights, with the effects as they are at z."""
        self._by_coefficients = [one.pose for one in columns_of(self.data, self.start.arm, partial(self.setup, z))]
        return super().gauss_newton(z, only, weights, evaluations)

    def _split(self, z: Array) -> tuple[Array, Array]:
        return z[: len(self.unknowns)], z[len(self.unknowns) :]
