"""The least-squares problem with the effects that the model lacks as further unknowns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.model_error import error_inputs, lacking, reference_pressure_pa
from calibration.identify.setup import Setup
from calibration.identify.tip_predictor import Predictor
from model.arrays import Array


class EffectsProblem(LeastSquaresProblem):
    """A least-squares problem whose z (n + m,) holds the unknowns, then the coefficients of the model error.

    amplitude (m,): standard deviations of the normal priors of the coefficients, about zero. The effects are errors of
    the pressures and loads that the model is given, so predictions follow them exactly. Their slopes are those of the
    equilibria.
    """

    def __init__(self, problem: LeastSquaresProblem, amplitude: Array) -> None:
        super().__init__(
            problem.data,
            problem.start,
            problem.free,
            problem.priors,
            substeps=problem.substeps,
            extrapolated=problem.extrapolated,
        )
        self._amplitude = amplitude
        terms, reference_pa = lacking(self.start.arm), reference_pressure_pa(self.data)
        self._inputs = [error_inputs(poses, reference_pa, terms) for poses in self.data]
        self._affected: tuple[Array, list[Predictor]] | None = None

    def extended(self, z: Array) -> Array:
        """The unknowns z (n,) with coefficients of zero."""
        return np.concatenate([z, np.zeros(len(self._amplitude))])

    def setup(self, z: Array, run: int | None = None) -> Setup:
        """The setup at z (n + m,), without the effects."""
        return super().setup(self._split(z)[0], run)

    def predictors(self, z: Array) -> Sequence[Predictor]:
        """The predictor of every run at z (n + m,), with the effects."""
        coefficients = self._split(z)[1]
        if self._affected is None or not np.array_equal(coefficients, self._affected[0]):
            poses = (own.added_to(one, coefficients) for own, one in zip(self._inputs, self.data, strict=True))
            self._affected = coefficients.copy(), [self.predictor(one) for one in poses]
        return self._affected[1]

    def _slopes_of_run(self, z: Array, run: int, only: Sequence[int]) -> Array:
        """Derivatives (K, D, n) of a run's predictions by the unknowns and coefficients `only`."""
        n, out = len(self.unknowns), super()._slopes_of_run(z, run, only)
        mine = [column for column, i in enumerate(only) if i >= n]
        by_all = self._inputs[run].slopes(self.predictors(z)[run], self.setup(z, run), self._split(z)[1])
        out[:, :, mine] = by_all[:, :, [only[column] - n for column in mine]]
        return out

    def prior_rows(self, z: Array) -> tuple[Array, Array]:
        """Rows (k, n + m) and gaps (k,) of the priors of unknowns and coefficients, in standard deviations."""
        unknowns, coefficients = self._split(z)
        rows, gaps = super().prior_rows(unknowns)
        return block_diag(rows, np.diag(1 / self._amplitude)), np.concatenate([gaps, coefficients / self._amplitude])

    def without_prior(self, only: Sequence[int]) -> int:
        """Number of the unknowns `only` that have no prior; coefficients have one."""
        return super().without_prior([i for i in only if i < len(self.unknowns)])

    def bounds(self, only: Sequence[int]) -> tuple[Array, Array]:
        """Lower and upper bounds of the unknowns and coefficients `only`; coefficients have none."""
        free = np.full(sum(i >= len(self.unknowns) for i in only), np.inf)
        lower, upper = super().bounds([i for i in only if i < len(self.unknowns)])
        return np.concatenate([lower, -free]), np.concatenate([upper, free])

    def _split(self, z: Array) -> tuple[Array, Array]:
        return z[: len(self.unknowns)], z[len(self.unknowns) :]
