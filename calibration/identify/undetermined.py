"""Unknowns that the data leave open: which are held at their start, and why."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identify.effects_problem import EffectsProblem
from calibration.identify.information import covariance as covariance_of
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.model_error_posterior import ModelErrorPosterior, model_error_posterior
from calibration.identify.results import Verdict
from calibration.identify.search import Progress
from calibration.identify.solution import Solution
from model.arrays import Array

# A parameter with a standard deviation above this many plausible spans is not identified.
UNDETERMINED_SPANS = 0.5
# Far from its start, the span of a parameter is this fraction of the distance: at four error bars it is identified.
_SPAN_PER_DISTANCE = 0.5
# Standard deviation, in spans, of a weak prior. It keeps undetermined directions finite, so that they do not affect
# parameters that they hardly correlate with.
PRIOR_SPANS = 2.0
_MIN_COMPONENT = 0.2
# An unknown that the fit moved by more spans than this, or closer to a bound than so many spans, is fitted again with
# the effects: a span may reach from the start to the bound.
_FAR_SPANS, _AT_BOUND_SPANS = 1.0, 0.05
# Decrease of the deviance, over that at its start, above which an unknown is published: three standard deviations.
_EXCLUDED = 9.0
# Information below which an unknown has no effect: a standard deviation of a thousand spans.
_NO_INFORMATION = 1e-6


@dataclass(frozen=True)
class JointPosterior:
    """Covariance (n, n) of all unknowns without a model error, in spans, and the posterior with it, if considered."""

    alone: Array
    model_error: ModelErrorPosterior | None

    @property
    def wide(self) -> Array:
        """Covariance (n, n) of all unknowns, in spans, with the model error if it is considered."""
        return self.alone if self.model_error is None else self.model_error.of_unknowns


@dataclass(frozen=True)
class HeldUnknown:
    """Why an unknown is held, and the information on it, in spans, if the model error obscures it; else None."""

    verdict: Verdict
    information: float | None = None


@dataclass(frozen=True)
class DeterminedFit:
    """The fit of what the data determine, the unknowns that are held, by number, and the posterior."""

    solution: Solution
    held: Mapping[int, HeldUnknown]
    posterior: JointPosterior


def determined_fit(
    problem: LeastSquaresProblem,
    joint: Solution,
    nuisances: Collection[str],
    *,
    with_model_error: bool,
    hold: bool,
    progress: Progress = lambda text: None,
) -> DeterminedFit:
    """Hold undetermined unknowns at their start and fit the others again; without `hold`, keep the joint solution.

    The new fit may be in a region where further unknowns are undetermined, so this is repeated. Nuisance parameters,
    which have a prior, are never held. What the data leave open comes first. Then come unknowns that the fit moved far
    from their start, if the model error leaves them open: fine data determine such a value although it is an error of
    the model that moved it.
    """
    solution, held = joint, dict[int, HeldUnknown]()
    free = [i for i, unknown in enumerate(problem.unknowns) if unknown.parameter.name not in nuisances]
    beside = [i for i in range(len(problem.unknowns)) if i not in free]
    while True:
        left = [i for i in free if hold and i not in held]
        by_data = _worst_first(scaled_information(solution.information, solution.z), left, beside)
        more = {i: HeldUnknown(_verdict(one.alone)) for i, one in by_data.items()}
        if not more:
            progress("posterior of the parameters and of the effects that the model lacks")
            posterior = _posterior(problem, solution, held, with_model_error)
            if posterior.model_error is not None:
                progress("fit together with these effects")
                more = _obscured(problem, solution, held, posterior.model_error, left)
            if not more:
                return DeterminedFit(solution, held, posterior)
        held |= more
        progress(f"fit with {len(held)} undetermined unknowns held")
        at = np.array([0.0 if i in held else value for i, value in enumerate(joint.z)])
        solution = problem.solve(at, sorted(held))


def _obscured(
    problem: LeastSquaresProblem,
    solution: Solution,
    held: Collection[int],
    error: ModelErrorPosterior,
    left: Sequence[int],
) -> dict[int, HeldUnknown]:
    """Those of the unknowns `left` that are far from their start, and open if the effects are fitted, too.

    The linearised model cannot tell: where the fit has taken up an effect, it no longer shows how they exchange. The
    curvature at the minimum tells only near it: along a curved valley the likelihood is steep on one side and flat on
    the other. So the value must also be more likely than the start, by the likelihood ratio with the effects fitted at
    both.
    """
    far = [i for i in left if _far(problem, i, float(solution.z[i]))]
    if not far:
        return {}
    effects = EffectsProblem(problem, error.amplitude)
    found = effects.solve(effects.extended(solution.z) + error.mean, sorted(held))
    n = len(problem.unknowns)
    z, information = found.z[:n], covariance_of(covariance_of(found.information)[:n, :n])
    others = [i for i in range(n) if i not in far and i not in held]
    undetermined = _worst_first(scaled_information(information, z), far, others)
    if undetermined:
        factors = span_factors(z)
        return {i: HeldUnknown(Verdict.OBSCURED, 1 / (one.std * factors[i]) ** 2) for i, one in undetermined.items()}
    ratios = {i: _likelihood_ratio(effects, found, i, held) for i in far}
    least = min(ratios, key=ratios.__getitem__)
    # The curvature is no measure of what such data say, so they are taken to say nothing.
    return {least: HeldUnknown(Verdict.OBSCURED, 0.0)} if ratios[least] < _EXCLUDED else {}


def _far(problem: LeastSquaresProblem, i: int, z: float) -> bool:
    unknown = problem.unknowns[i]
    at_bound = not unknown.lower + _AT_BOUND_SPANS < z < unknown.upper - _AT_BOUND_SPANS
    return abs(z) > _FAR_SPANS or at_bound


def _likelihood_ratio(effects: EffectsProblem, found: Solution, i: int, held: Collection[int]) -> float:
    """By how much the deviance is smaller at a solution than with unknown i at its start.

    A weak prior about the start is counted as part of the deviance.
    """
    at_start = found.z.copy()
    at_start[i] = 0.0
    there = effects.solve(at_start, sorted({*held, i}))
    gain = effects.deviance(there, found.correlation) - effects.deviance(found, found.correlation)
    return gain - float(found.z[i] / PRIOR_SPANS) ** 2


def _posterior(
    problem: LeastSquaresProblem, solution: Solution, held: Mapping[int, HeldUnknown], with_model_error: bool
) -> JointPosterior:
    assumed, alone = _joint_covariance(problem, solution, held)
    return JointPosterior(alone, model_error_posterior(problem, solution, assumed) if with_model_error else None)


@dataclass(frozen=True)
class _Undetermined:
    """Standard deviation of an unknown, and the information on it if all others were known; in spans."""

    std: float
    alone: float


def _worst_first(information: Array, only: Sequence[int], beside: Sequence[int]) -> dict[int, _Undetermined]:
    """The undetermined ones of the unknowns `only`, by number; each is known to those that follow.

    beside: unknowns that are uncertain, too.
    """
    left, found = list(only), dict[int, _Undetermined]()
    while left:
        part = [*left, *beside]
        std = standard_deviations(information[np.ix_(part, part)])[: len(left)]
        worst = int(np.argmax(std))
        if std[worst] <= UNDETERMINED_SPANS:
            break
        i = left.pop(worst)
        found[i] = _Undetermined(float(std[worst]), float(information[i, i]))
    return found


def _verdict(alone: float) -> Verdict:
    """The verdict on an undetermined unknown with this information if all others were known."""
    if alone < _NO_INFORMATION:
        return Verdict.NO_EFFECT
    return Verdict.UNDECIDED if alone < 1 / UNDETERMINED_SPANS**2 else Verdict.ENTANGLED


def open_directions(problem: LeastSquaresProblem, joint: Solution) -> tuple[str, ...]:
    """Eigenvectors of the information, in spans, with a standard deviation of half a span or more."""
    values, vectors = np.linalg.eigh(scaled_information(joint.information, joint.z))
    combinations = []
    for k in np.flatnonzero(values < 1 / UNDETERMINED_SPANS**2):
        vector = vectors[:, k]
        order = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > _MIN_COMPONENT]
        sign = 1.0 if vector[order[0]] > 0 else -1.0
        terms = [f"{sign * vector[i]:+.2f} {problem.unknowns[i].parameter.name}" for i in order]
        combinations.append(" ".join(terms))
    return tuple(combinations)


def span_factors(z: Array) -> Array:
    """Factors (n,) from the spans at the start to the spans at z (n,)."""
    out: Array = np.maximum(1.0, _SPAN_PER_DISTANCE * np.abs(z))
    return out


def scaled_information(information: Array, z: Array) -> Array:
    """An information (n, n) in the spans at z (n,).

    A start that is wrong by an order of magnitude has a span that is too small by as much. In units of that span a
    well-determined parameter would appear undetermined, and would be fixed at the wrong start.
    """
    factors = span_factors(z)
    return information * np.outer(factors, factors)


def standard_deviations(information: Array) -> Array:
    """Standard deviations (n,) in spans; very large without information."""
    return np.sqrt(np.diagonal(covariance_of(information)))


def _joint_covariance(
    problem: LeastSquaresProblem, solution: Solution, held: Mapping[int, HeldUnknown]
) -> tuple[Array, Array]:
    """Information (n,) that is assumed of the held unknowns, and the covariance (n, n) of all with it, in spans.

    It gives each of them, worst first, an error of `UNDETERMINED_SPANS` together with what the data say of it: that of
    the least determined unknown that is not held. With a fixed amount, more data could widen error bars.
    """
    every = range(len(problem.unknowns))
    assumed = np.zeros(len(every))
    if not held:
        return assumed, covariance_of(solution.information)
    whole = problem.solution(solution.z, every, solution.weights, solution.discrepancy, solution.solved)
    left = list(every)
    for i, one in held.items():
        known = one.information
        if known is None:
            known = 1 / standard_deviations(whole.information[np.ix_(left, left)])[left.index(i)] ** 2
        assumed[i] = max(0.0, 1 / UNDETERMINED_SPANS**2 - known)
        left.remove(i)
    return assumed, covariance_of(whole.information + np.diag(assumed))


def partners_of(information: Array, i: int) -> list[int]:
    """The other unknowns that must be known to determine unknown i.

    Greedy: conditions on the one that reduces the variance most, until it is determined. If several suffice alone, all
    of them are returned.
    """
    n, enough = len(information), UNDETERMINED_SPANS**2
    covariance = np.linalg.inv(information + np.eye(n) / PRIOR_SPANS**2)
    found: list[int] = []
    while covariance[i, i] > enough and len(found) < n - 1:
        left = {
            j: float(covariance[i, i] - covariance[i, j] ** 2 / covariance[j, j])
            for j in range(n)
            if j != i and j not in found
        }
        best = min(left, key=left.__getitem__)
        found += [j for j, variance in left.items() if variance <= enough] or [best]
        covariance -= np.outer(covariance[:, best], covariance[best]) / covariance[best, best]
    return found
