"""Robust nonlinear least squares of an identification: iterative reweighting, unknowns scaled by their span."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from calibration.identify.gauss_newton import gauss_newton
from calibration.identify.information import determined_covariance, sandwich
from calibration.identify.likelihood import (
    Discrepancy,
    Weights,
    apply_frequency_mask,
    frequency_mask,
    huber,
    score_covariance,
    whitened,
)
from calibration.identify.parameter import Parameter, Prior
from calibration.identify.poses import Poses
from calibration.identify.pressure_response import PressureErrors
from calibration.identify.scaled_parameter import ScaledParameter
from calibration.identify.setup import Setup
from calibration.identify.solution import Solution
from calibration.identify.tip_predictor import FINE_SUBSTEPS, SUBSTEPS, Predictor
from model.arrays import Array

# Step of an unknown, in spans, for the model's directional derivatives.
_STEP = 1e-7
# Standard deviation, in spans, of the ridge term towards the start. It only stops undetermined unknowns from drifting.
RIDGE_SPANS = 5.0
_ROUNDS = 5
_SAME_COVARIANCE = 0.05
_SAME_SLOPE = 3e-3


@dataclass
class LeastSquaresProblem:
    """The least-squares problem: data, starting setup, free parameters and their priors.

    substeps, extrapolated: time steps of a motion, see `Predictor`; 0 substeps choose both by the free parameters. For
    the bootstrap: prior_shift (m,) moves the means of the priors, in standard deviations and in the order of the
    unknowns that have a prior. progress is called with the rms distance [m] after each step of the search.
    """

    data: Sequence[Poses]
    start: Setup
    free: Sequence[Parameter]
    priors: Mapping[str, Prior] = field(default_factory=dict)
    prior_shift: Array | None = None
    substeps: int = 0
    extrapolated: bool = False
    progress: Callable[[float], None] = field(default=lambda rms_m: None)

    def __post_init__(self) -> None:
        shared = [ScaledParameter.of_setup(p, None, self.start) for p in self.free if not p.per_run]
        own = [
            ScaledParameter.of_setup(p, run, self.start)
            for p in self.free
            if p.per_run
            for run in range(len(self.data))
        ]
        self.unknowns = (*shared, *own)
        fast = any(p.name in ("density_kg_m3", "damping_s", "sensor_lag_s") for p in self.free)
        if not self.substeps:
            self.substeps, self.extrapolated = (FINE_SUBSTEPS, True) if fast else (SUBSTEPS, False)
        self._predictors = [self.predictor(poses) for poses in self.data]
        self._frequency_masks = [
            frequency_mask(poses) if poses.moving else np.ones(len(poses) // 2 + 1) for poses in self.data
        ]
        self._pressure: tuple[Array, list[PressureErrors]] | None = None
        self._kept_slopes: tuple[Array, tuple[int, ...], list[Array]] | None = None
        self._columns = [
            [i for i, u in enumerate(self.unknowns) if u.run is None or u.run == run] for run in range(len(self.data))
        ]
        self._runs_of_their_own = {u.run for u in own}
        self._setup = lru_cache(maxsize=64)(self._written)

    def measured_as(self, data: Sequence[Poses]) -> LeastSquaresProblem:
        """The problem with other tips, orientations and errors in the same runs; what is solved is kept."""
        other = replace(self, data=data)
        other._predictors = [replace(own, poses=poses) for own, poses in zip(self._predictors, data, strict=True)]
        other._kept_slopes = self._kept_slopes
        return other

    def predictor(self, poses: Poses) -> Predictor:
        """A predictor of some poses with the time steps of the problem."""
        return Predictor(poses, self.substeps, self.extrapolated)

    @property
    def measured(self) -> int:
        """Numbers measured: three per tip or point of a section, and three per orientation."""
        return int(sum(poses.measured.sum() for poses in self.data))

    def setup(self, z: Array, run: int | None = None) -> Setup:
        """The setup at z, with the per-run values of run number `run`, if given."""
        return self._setup(tuple(z.tolist()), run if run in self._runs_of_their_own else None)

    def _written(self, z: tuple[float, ...], run: int | None) -> Setup:
        out = self.start
        for unknown, value in zip(self.unknowns, z, strict=True):
            if unknown.run is None or unknown.run == run:
                out = unknown.parameter.write(out, unknown.at(value))
        return out

    def rates(self, z: Array) -> Array:
        """Derivatives (n,) of the unknowns' values by z (n,)."""
        return np.array([unknown.rate(value) for unknown, value in zip(self.unknowns, z.tolist(), strict=True)])

    def values(self, z: Array) -> Array:
        """The unknowns' values (n,) at z (n,)."""
        return np.array([unknown.at(value) for unknown, value in zip(self.unknowns, z.tolist(), strict=True)])

    def predictors(self, z: Array) -> Sequence[Predictor]:
        """The predictor of every run at z (n,)."""
        return self._predictors

    def predicted(self, z: Array) -> list[Array]:
        """Tips (K, 3) of every run."""
        return [predictor(self.setup(z, run)) for run, predictor in enumerate(self.predictors(z))]

    def rotations(self, z: Array) -> list[Array]:
        """Orientations (K, 3, 3) of every run."""
        return [predictor.rotations(self.setup(z, run)) for run, predictor in enumerate(self.predictors(z))]

    def sections(self, z: Array) -> list[tuple[tuple[Array, Array], ...]]:
        """Points (K, 3) and orientations (K, 3, 3) of the sections of every run."""
        return [predictor.sections(self.setup(z, run)) for run, predictor in enumerate(self.predictors(z))]

    def gaps(self, z: Array) -> list[Array]:
        """Measured minus predicted (K, D) of every run; see `Predictor.gap`."""
        return [predictor.gap(self.setup(z, run)) for run, predictor in enumerate(self.predictors(z))]

    def rms_m(self, z: Array) -> float:
        """Root mean square distance [m] from measured to predicted at z (n,)."""
        gaps = [poses.tip_m - tips for poses, tips in zip(self.data, self.predicted(z), strict=True)]
        squares = (np.concatenate(gaps) ** 2).sum(axis=1)
        return float(np.sqrt(np.nanmean(squares)))

    def slopes(self, z: Array, only: Sequence[int]) -> list[Array]:
        """Derivatives (K, D, n) of every run's predictions by the unknowns `only`; the last ones are cached.

        They are reused if z has changed by less than a few thousandths of a span.
        """
        if self._kept_slopes is not None:
            last_z, columns, kept = self._kept_slopes
            if set(only) <= set(columns) and np.abs(z - last_z).max(initial=0.0) < _SAME_SLOPE:
                chosen = [columns.index(i) for i in only]
                return [slope[:, :, chosen] for slope in kept]
        out = [np.nan_to_num(self._slopes_of_run(z, run, only), nan=0.0) for run in range(len(self.data))]
        self._kept_slopes = (z.copy(), tuple(only), out)
        return out

    def _slopes_of_run(self, z: Array, run: int, only: Sequence[int]) -> Array:
        """Derivatives (K, D, n) of a run's predictions by the unknowns `only`; NaN where there is no solution."""
        mine = [(column, i) for column, i in enumerate(only) if i in self._columns[run]]
        perturbed, steps = self._perturbed(z, run, [i for _, i in mine])
        out = np.zeros((len(self.data[run]), self.data[run].numbers, len(only)))
        out[:, :, [column for column, _ in mine]] = self.predictors(z)[run].slopes(self.setup(z, run), perturbed, steps)
        return out

    def whitened_slopes(self, z: Array, masked: bool = True) -> tuple[list[Array], Array]:
        """Slopes (K, D, n) of every run's predictions in standard deviations, and of the priors (m, n).

        masked: after the frequency masks, as the fit uses them.
        """
        every = range(len(self.unknowns))
        weights, _ = self.weights(z, 0.0)
        rows = [own.whitened(slope) for own, slope in zip(weights, self.slopes(z, every), strict=True)]
        if masked:
            rows = [self._filtered(run, own) for run, own in enumerate(rows)]
        return rows, self.prior_rows(z)[0]

    def _perturbed(self, z: Array, run: int, which: Sequence[int]) -> tuple[list[Setup], list[float]]:
        """A run's setups with one perturbed unknown each, and the steps; backward at the upper bound."""
        base, perturbed, steps = self.setup(z, run), [], []
        for i in which:
            unknown = self.unknowns[i]
            step = -_STEP if z[i] + _STEP > unknown.upper else _STEP
            perturbed.append(unknown.parameter.write(base, unknown.at(float(z[i] + step))))
            steps.append(step)
        return perturbed, steps

    def solve(self, z: Array, fixed: Sequence[int] = (), rounds: int = _ROUNDS, evaluations: int = 40) -> Solution:
        """Maximise the likelihood from z (n,) by iteratively reweighted Gauss-Newton; `fixed` unknowns keep their z.

        Correlated entries count as fewer ones, as in the error bars: a long motion that the model cannot follow would
        otherwise push every unknown to its limit, whatever its prior says.
        """
        only = [i for i in range(len(z)) if i not in set(fixed)]
        z = z.copy()
        weights, sigma = self.weights(z, self.without_prior(only))
        solution = self.solution(z, only, weights, sigma, solved=True)
        for _ in range(rounds):
            before = solution
            if only:
                z, solved = self.gauss_newton(z, only, before.weights, before.correlation, evaluations)
                before = replace(before, solved=solved)
            weights, sigma = self.weights(z, self._fitted(z, only, before.weights, before.correlation))
            solution = self.solution(z, only, weights, sigma, before.solved)
            if solution.close_to(before):
                break
        return solution

    def without_prior(self, only: Sequence[int]) -> int:
        """Number of the unknowns `only` that have no prior."""
        return sum(self.unknowns[i].parameter.name not in self.priors for i in only)

    def bounds(self, only: Sequence[int]) -> tuple[Array, Array]:
        """Lower and upper bounds of z of the unknowns `only`."""
        chosen = [self.unknowns[i] for i in only]
        return np.array([one.lower for one in chosen]), np.array([one.upper for one in chosen])

    def _fitted(self, z: Array, only: list[int], weights: tuple[Weights, ...], correlation: Sequence[float]) -> float:
        """Effective number of unknowns that the data determine: a narrow prior leaves them nothing to determine."""
        if not only:
            return 0.0
        slope = self._slope_rows(z, only, weights, correlation)
        data = slope[: sum(len(poses) * poses.numbers for poses in self.data)]
        return float(np.trace(determined_covariance(slope.T @ slope) @ (data.T @ data)))

    def weights(self, z: Array, fitted: float) -> tuple[tuple[Weights, ...], Discrepancy]:
        """The weights of the residuals near z, and the model discrepancy."""
        pressure, gaps = self.pressure_errors(z), self.gaps(z)
        covariances = [poses.pose_covariance + own.covariance for own, poses in zip(pressure, self.data, strict=True)]
        sigma = Discrepancy.estimated(self.data, gaps, covariances, fitted)
        weights = (
            Weights.of(
                poses.pose_covariance + own.independent + sigma.covariance(poses.kinds),
                poses.measured,
                own.common,
                own.motion,
            )
            for own, poses in zip(pressure, self.data, strict=True)
        )
        return tuple(weights), sigma

    def log_likelihood(self, z: Array) -> float:
        """Log likelihood of the data at z (n,), with the model discrepancy estimated there."""
        weights, _ = self.weights(z, 0)
        total = 0.0
        for run, (poses, gap) in enumerate(zip(self.data, self.gaps(z), strict=True)):
            rows = self._filtered(run, huber(whitened(poses, gap, weights[run]))[0])
            total -= 0.5 * (float((rows**2).sum()) + weights[run].log_det)
        return total

    def solution(
        self, z: Array, only: Sequence[int], weights: tuple[Weights, ...], sigma: Discrepancy, solved: bool
    ) -> Solution:
        """Likelihood and information at z; only the fitted unknowns `only` get information."""
        at = self.gaps(z)
        loss, log_likelihood = 0.0, 0.0
        slopes = self.slopes(z, only)
        rows = []
        for run, poses in enumerate(self.data):
            slope = -weights[run].whitened(slopes[run])
            loss_rows, slope_rows = huber(whitened(poses, at[run], weights[run]), slope)
            assert slope_rows is not None
            rows.append((self._filtered(run, loss_rows), self._filtered(run, slope_rows)))
            squares = float((rows[-1][0] ** 2).sum())
            loss += squares
            log_likelihood -= 0.5 * (squares + weights[run].log_det)
        prior_rows, prior_gap = self.prior_rows(z)
        loss += float(prior_gap @ prior_gap)
        prior = prior_rows.T @ prior_rows
        information, correlation = self._information(rows, prior, only, [own.shared for own in weights])
        return Solution(z, information, prior, loss, log_likelihood, sigma, correlation, weights, solved)

    def _information(
        self, rows: Sequence[tuple[Array, Array]], prior: Array, only: Sequence[int], shared: Sequence[bool]
    ) -> tuple[Array, tuple[float, ...]]:
        """Sandwich (HAC) information (n, n), and the factor by which correlation reduces each run's entries.

        shared: of each run, whether its entries share errors.
        """
        part = np.ix_(only, only)
        curvatures = [np.einsum("kin,kim->nm", slope, slope) for _, slope in rows]
        covariance = determined_covariance(np.sum(curvatures, axis=0) + prior[part])
        correlation = []
        curvature, scores = prior[part].copy(), prior[part].copy()
        for run, (residual, slope) in enumerate(rows):
            poses, own = self.data[run], curvatures[run]
            score = own
            if poses.in_sequence:
                gain, seen = self._frequency_masks[run], float(poses.has_tip.mean())
                score = score_covariance(residual, slope, gain, seen, covariance, at_least_stated=shared[run])
            expected = float(np.trace(covariance @ own))
            factor = max(1.0, float(np.trace(covariance @ score)) / expected) if expected > 0 else 1.0
            correlation.append(factor)
            curvature += own / factor
            scores += score / factor**2
        information = prior.copy()
        information[part] = sandwich(curvature, scores)
        return information, tuple(correlation)

    def loss(self, z: Array, weights: tuple[Weights, ...], correlation: Sequence[float]) -> float:
        """Robust sum of squares at given weights, with priors; each run is divided by its correlation factor."""
        gap = self.prior_rows(z)[1]
        total = float(gap @ gap)
        for run, (poses, own) in enumerate(zip(self.data, self.gaps(z), strict=True)):
            robust, _ = huber(whitened(poses, own, weights[run]))
            total += float((self._filtered(run, robust) ** 2).sum()) / correlation[run]
        return total

    def deviance(self, solution: Solution, correlation: Sequence[float]) -> float:
        """Minus twice the log posterior density at a solution, up to a constant; correlation: as in `loss`."""
        scale = sum(one.log_det / factor for one, factor in zip(solution.weights, correlation, strict=True))
        return self.loss(solution.z, solution.weights, correlation) + scale

    def pressure_errors(self, z: Array) -> list[PressureErrors]:
        """Errors of the predictions by pressure errors, per run; recomputed only after a noticeable change of z."""
        if self._pressure is None or np.abs(z - self._pressure[0]).max(initial=0.0) > _SAME_COVARIANCE:
            found = [p.pressure_errors(self.setup(z, run)) for run, p in enumerate(self.predictors(z))]
            self._pressure = (z.copy(), found)
        return self._pressure[1]

    def gauss_newton(
        self, z: Array, only: list[int], weights: tuple[Weights, ...], correlation: Sequence[float], evaluations: int
    ) -> tuple[Array, bool]:
        """The minimum of `loss` over the unknowns `only`, from z (n,), and whether the search converged."""

        def whole(x: Array) -> Array:
            out = z.copy()
            out[only] = x
            return out

        x, converged = gauss_newton(
            lambda x: self._rows(whole(x), only, weights, correlation),
            lambda x: self._slope_rows(whole(x), only, weights, correlation),
            z[only],
            bounds=self.bounds(only),
            evaluations=evaluations,
            progress=lambda x: self.progress(self.rms_m(whole(x))),
        )
        return whole(x), converged

    def _rows(self, z: Array, only: list[int], weights: tuple[Weights, ...], correlation: Sequence[float]) -> Array:
        """The residual vector: tips, priors, ridge."""
        rows = []
        for run, gap in enumerate(self.gaps(z)):
            robust, _ = huber(whitened(self.data[run], gap, weights[run]))
            rows.append((self._filtered(run, robust) * np.sqrt(1 / correlation[run])).ravel())
        return np.concatenate([*rows, self.prior_rows(z)[1], z[only] / RIDGE_SPANS])

    def _slope_rows(
        self, z: Array, only: list[int], weights: tuple[Weights, ...], correlation: Sequence[float]
    ) -> Array:
        """Jacobian of `_rows` by the unknowns `only`."""
        at = self.gaps(z)
        rows = []
        for run, tips_slope in enumerate(self.slopes(z, only)):
            turned = -weights[run].whitened(tips_slope)
            _, out = huber(whitened(self.data[run], at[run], weights[run]), turned)
            assert out is not None
            rows.append((self._filtered(run, out) * np.sqrt(1 / correlation[run])).reshape(-1, len(only)))
        return np.concatenate([*rows, self.prior_rows(z)[0][:, only], np.eye(len(only)) / RIDGE_SPANS])

    def prior_rows(self, z: Array) -> tuple[Array, Array]:
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

    def _filtered(self, run: int, rows: Array) -> Array:
        """Rows (K, ..) of a run after its frequency mask."""
        return apply_frequency_mask(rows, self._frequency_masks[run])
