"""Gibbs sampler of the amplitudes of the terms of a model error.

The amplitude of one term given those of the others needs the information on its own coefficients only, marginal over
the others (Schur complement), in its principal axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from calibration.identify.model_error import CoefficientPrior
from model.arrays import Array

Levels = tuple[int, ...]

# Probability that a term is present before anything is known of this arm.
PRESENT = 0.5
# Amplitudes of a term that is present: these quantiles of a half-normal distribution, all equally probable.
_QUANTILES = (np.arange(6) + 0.5) / 6
LEVELS: Array = np.concatenate([[0.0], ndtri(0.5 + 0.5 * _QUANTILES)])
"""Amplitudes of a term over its scale; the first: absent."""
_LOG_PRIOR = np.log(np.concatenate([[1 - PRESENT], np.full(len(_QUANTILES), PRESENT / len(_QUANTILES))]))
# Sweeps of the sampler, and those before them that do not count.
_SWEEPS, _BURN_IN = 200, 30


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


@dataclass(frozen=True)
class Sampled:
    """Samples of the model error: coefficients (S, m), present (S, terms), noise (S,) as its number.

    mean (n + m,), second (n + m, n + m): mean, and mean squares and products, of unknowns and coefficients. probability
    (terms,) of presence; absent: that of no term.
    """

    mean: Array
    second: Array
    coefficients: Array
    present: NDArray[np.bool_]
    noise: NDArray[np.intp]
    probability: Array
    absent: float


class AmplitudeSampler:
    """Samples amplitudes, noise and coefficients; keeps factorisations, which do not depend on the residuals.

    equations: for each noise. prior: of the m coefficients. scale (terms,): of the amplitudes.
    """

    def __init__(
        self, equations: Sequence[NormalEquations], prior: CoefficientPrior, scale: Array, sweeps: int = _SWEEPS
    ) -> None:
        self._equations, self._prior, self._scale, self._sweeps = tuple(equations), prior, scale, sweeps
        self._conditional: Callable[[int, Levels, int], _Conditional] = cache(self._factorised)

    def _amplitude(self, level: Levels) -> Array:
        out: Array = (self._scale * LEVELS[list(level)])[self._prior.term]
        return out

    def _factorised(self, k: int, others: Levels, noise: int) -> _Conditional:
        return _Conditional.of(
            self._equations[noise].seen, self._prior, self._amplitude(others), k, self._scale[k] * LEVELS
        )

    def sample(self, gradients: Sequence[Array] | None = None) -> Sampled:
        """Samples for other gradients (m,), one for each noise, than those of the equations.

        Each sweep draws the amplitude of each term given the others (zero: absent), and the noise; the coefficients are
        integrated out. The seed is fixed.
        """
        rng = np.random.default_rng(0)
        prior, equations = self._prior, self._equations
        gradients = gradients or [one.gradient for one in equations]
        count, m, n = len(self._scale), len(prior.term), len(equations[0].at_fit)
        level, noise = [0] * count, len(equations) - 1
        average, second = np.zeros(n + m), np.zeros((n + m, n + m))
        probability, absent = np.zeros(count), 0.0
        coefficients, present, noises = [], [], []

        # The sampler returns to few states again and again.
        @cache
        def level_chance(k: int, others: Levels, noise: int) -> Array:
            return _cumulative(self._conditional(k, others, noise).log_evidence(gradients[noise]) + _LOG_PRIOR)

        @cache
        def noise_chance(level: Levels) -> Array:
            own = self._amplitude(level)
            return _cumulative(
                np.array([
                    log_evidence(one, own * prior.std, own * prior.mean, gradient)
                    for one, gradient in zip(equations, gradients, strict=True)
                ])
            )  # fmt: skip

        @cache
        def given(level: Levels, noise: int) -> tuple[Array, Array, Array, Array]:
            own = self._amplitude(level)
            mean, root = coefficients_given(equations[noise], own * prior.std, own * prior.mean, gradients[noise])
            return mean, root, *_moments(equations[noise], mean, root)

        for sweep in range(-_BURN_IN, self._sweeps):
            for k in range(count):
                level[k] = 0
                chance = level_chance(k, tuple(level), noise)
                if sweep >= 0:
                    probability[k] += (1 - chance[0]) / self._sweeps
                    absent += chance[0] / (count * self._sweeps) if not any(level) else 0.0
                level[k] = int(chance.searchsorted(rng.random(), side="right"))
            if len(equations) > 1:
                noise = int(noise_chance(tuple(level)).searchsorted(rng.random(), side="right"))
            if sweep >= 0:
                mean, root, centre, own_second = given(tuple(level), noise)
                average += centre / self._sweeps
                second += own_second / self._sweeps
                coefficients.append(mean + root @ rng.standard_normal(root.shape[1]))
                present.append([one > 0 for one in level])
                noises.append(noise)
        return Sampled(
            average, second, np.array(coefficients), np.array(present), np.array(noises), probability, absent
        )


@dataclass(frozen=True)
class _Conditional:
    """What the data say of the coefficients of one term, with prior means and deviations for an amplitude of one.

    own, active: indices of its coefficients, and of those of the terms that are present. pull (own, active), shift
    (own,): the gradient on its own coefficients, marginal over the others, is g[own] - pull g[active] - shift. axes,
    values: principal axes and values of its information, over the deviations. against (own,): gradient by the means,
    along these axes. mean (own,), curvature: of the means. levels (L,): amplitudes.
    """

    own: NDArray[np.intp]
    active: NDArray[np.intp]
    pull: Array
    shift: Array
    axes: Array
    values: Array
    against: Array
    mean: Array
    curvature: float
    levels: Array

    @classmethod
    def of(cls, seen: Array, prior: CoefficientPrior, amplitude: Array, k: int, levels: Array) -> _Conditional:
        """For information `seen` (m, m), amplitudes (m,) of the other terms, and the amplitudes `levels` of term k."""
        own, active = np.flatnonzero(prior.term == k), np.flatnonzero(amplitude)
        information, crossed, among = (
            seen[np.ix_(own, own)], seen[np.ix_(own, active)], seen[np.ix_(active, active)],
        )  # fmt: skip
        deviation, mean = (amplitude * prior.std)[active], (amplitude * prior.mean)[active]
        root = _root(among, deviation)
        half = crossed @ root
        information = information - half @ half.T
        pull = half @ root.T
        values, vectors = np.linalg.eigh(prior.std[own][:, None] * information * prior.std[own])
        axes = vectors.T * prior.std[own]
        own_mean = prior.mean[own]
        by_mean = information @ own_mean
        return cls(
            own, active, pull, crossed @ mean - pull @ (among @ mean), axes, np.maximum(values, 0.0), axes @ by_mean,
            own_mean, float(own_mean @ by_mean), levels,
        )  # fmt: skip

    def log_evidence(self, gradient: Array) -> Array:
        """Log evidence (L,) of the amplitudes, up to a common constant."""
        own = gradient[self.own] - self.pull @ gradient[self.active] - self.shift
        s = self.levels
        spread = 1.0 + np.square(s)[:, None] * self.values
        pulled = self.axes @ own - s[:, None] * self.against
        out: Array = (
            s * float(self.mean @ own)
            - 0.5 * np.square(s) * self.curvature
            - 0.5 * np.log(spread).sum(axis=1)
            + 0.5 * np.square(s) * (np.square(pulled) / spread).sum(axis=1)
        )
        return out


def _cumulative(log: Array) -> Array:
    chance = np.exp(log - log.max()).cumsum()
    out: Array = chance / chance[-1]
    return out


def _root(information: Array, deviation: Array) -> Array:
    """A root of the covariance of coefficients with an information and prior standard deviations."""
    lower = np.linalg.cholesky(np.eye(len(deviation)) + deviation[:, None] * information * deviation)
    out: Array = deviation[:, None] * np.linalg.inv(lower).T
    return out


def log_evidence(equations: NormalEquations, deviation: Array, mean: Array, gradient: Array | None = None) -> float:
    """Log evidence for prior standard deviations and means (m,) of the coefficients, up to a common constant.

    gradient (m,): instead of that of the equations.
    """
    gradient = equations.gradient if gradient is None else gradient
    active = np.flatnonzero(deviation)
    root = _root(equations.seen[np.ix_(active, active)], deviation[active])
    known = equations.seen @ mean
    pulled = root.T @ (gradient - known)[active]
    log_root = -float(np.log(np.diagonal(root) / deviation[active]).sum())
    return equations.constant + float(mean @ (gradient - 0.5 * known)) - log_root + 0.5 * float(pulled @ pulled)


def coefficients_given(
    equations: NormalEquations, deviation: Array, mean: Array, gradient: Array | None = None
) -> tuple[Array, Array]:
    """Mean (m,) and a root (m, a) of the covariance of the coefficients with prior standard deviations and means (m,).

    a: the number of coefficients whose deviation is not zero. gradient (m,): instead of that of the equations.
    """
    gradient = equations.gradient if gradient is None else gradient
    active = np.flatnonzero(deviation)
    root = np.zeros((len(deviation), len(active)))
    root[active] = _root(equations.seen[np.ix_(active, active)], deviation[active])
    return mean + root @ (root.T @ (gradient - equations.seen @ mean)), root


def _moments(equations: NormalEquations, mean: Array, root: Array) -> tuple[Array, Array]:
    """Mean (n + m,), and mean squares and products (n + m, n + m), of unknowns and coefficients.

    root: of the coefficients' covariance.
    """
    absorbed = equations.absorbed
    centre = np.concatenate([equations.at_fit - absorbed @ mean, mean])
    spread = np.concatenate([-absorbed @ root, root])
    out: Array = np.outer(centre, centre) + spread @ spread.T
    n = len(equations.at_fit)
    out[:n, :n] += equations.inverse
    return centre, out
