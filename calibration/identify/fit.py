"""Maximum-likelihood identification: from poses to parameters with error bars, or a verdict why there are none."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.identify.errors import NoDataError
from calibration.identify.information import covariance as covariance_of
from calibration.identify.least_squares import LeastSquaresProblem, Solution
from calibration.identify.likelihood import drifting, outlying, whitened
from calibration.identify.model_error_posterior import model_error_posterior
from calibration.identify.nuisance import nuisance_parameters
from calibration.identify.parameters import Prior, named
from calibration.identify.poses import Poses
from calibration.identify.results import NORMAL_95, Estimate, Fit, RunFit, Verdict, with_means_of_runs
from calibration.identify.search import Progress, initial_point, point_of, search
from calibration.identify.setup import Setup
from calibration.identify.unknown import Unknown, with_own_values

Array = NDArray[np.float64]

# A parameter with a standard deviation above this many plausible spans is not identified.
UNDETERMINED_SPANS = 0.5
# Far from its start, the span of a parameter is this fraction of the distance: at four error bars it is identified.
_SPAN_PER_DISTANCE = 0.5
_PRIOR_ONLY_RATIO = 0.95
# Standard deviation, in spans, of a weak prior. It keeps undetermined directions finite, so that they do not affect
# parameters that they hardly correlate with.
_PRIOR_SPANS = 2.0
_MIN_COMPONENT = 0.2


def identify(
    data: Sequence[Poses],
    start: Setup,
    free: Iterable[str],
    priors: Mapping[str, Prior] | None = None,
    starts: int | None = 1,
    seed: int = 0,
    initial_values: Mapping[tuple[str, str], float] | None = None,
    substeps: int = 0,
    stated: Mapping[str, Prior] | None = None,
    per_run: Iterable[str] = (),
    progress: Progress = lambda text: None,
    hold_undetermined: bool = True,
) -> Fit:
    """Maximum likelihood of the free parameters over all runs, static and moving ones together.

    priors: by name. starts: number of starting points; the first is `start`, the others are random around it; None
    chooses it by the results (see `search`). initial_values: by (name, run), replace the first starting point, for
    example by a fit to similar data; undetermined parameters are still fixed at `start`. substeps: see
    `LeastSquaresProblem`. stated: value and uncertainty of every parameter, by name. With it, what is not free is
    estimated, too, with its stated value as prior, so that its uncertainty is in all error bars; without it, what is
    not free is exact. per_run: names of parameters, free or not, with a value of their own in each run, as a mounting
    that was undone between the runs. hold_undetermined: fix at `start` what the data do not determine. False keeps it
    at the maximum of the likelihood: for a comparison, in which no law is refuted by a wrong number of the start.

    Raises:
        NoDataError: no measured tip.
        UnknownParameter: a name in `free`, `priors` or `per_run`.
    """
    if not any(poses.has_tip.any() for poses in data):
        raise NoDataError("no run holds a measured tip")
    actuators = data[0].actuators
    if any(poses.actuators != actuators for poses in data):
        raise NoDataError("the runs are of arms with different numbers of actuators")
    parameters = named(free, actuators)
    held = () if stated is None else nuisance_parameters(start, data, parameters)
    given = {p.name: prior for name, prior in (priors or {}).items() for p in named([name], actuators)}
    known = {p.name: (stated or {})[p.name] for p in held} | given
    every = with_own_values((*parameters, *held), per_run, actuators)
    problem = LeastSquaresProblem(data, start, every, known, substeps=substeps)
    first = initial_point(problem, progress) if initial_values is None else point_of(problem, initial_values)
    searched = search(problem, first, starts, seed, progress)
    joint = searched.best
    nuisances = {p.name for p in held}
    solution, fixed = _fix_undetermined(problem, joint, nuisances) if hold_undetermined else (joint, {})
    assumed, alone = _joint_covariance(problem, solution, fixed)
    error = None if stated is None else model_error_posterior(problem, solution, assumed)
    wide = alone if error is None else error.second[: len(alone), : len(alone)]
    estimates, covariance = _estimates(problem, solution, joint, fixed, nuisances, wide)
    rates = problem.rates(solution.z)
    estimates = tuple(replace(e, stated=(stated or {}).get(e.name), prior=known.get(e.name)) for e in estimates)
    return Fit(
        setup=with_means_of_runs(problem.setup(solution.z), estimates),
        start=start,
        estimates=estimates,
        covariance=covariance,
        joint_covariance=wide,
        fitted_covariance=alone * np.outer(rates, rates),
        runs=_runs(problem, solution),
        log_likelihood=solution.log_likelihood,
        loss=solution.loss,
        discrepancy=solution.discrepancy,
        measured=problem.measured,
        fitted=sum(not e.nuisance for e in estimates) - len(fixed),
        starts=len(searched.losses),
        agreeing_starts=searched.agreeing,
        worse_than_start=searched.worse_than_start,
        solved=solution.solved,
        open_directions=_open_directions(problem, joint),
        start_losses=searched.losses,
        problem=problem,
        solution=solution,
        model_error=error,
    )


def _open_directions(problem: LeastSquaresProblem, joint: Solution) -> tuple[str, ...]:
    """Eigenvectors of the information, in spans, with a standard deviation of half a span or more."""
    values, vectors = np.linalg.eigh(_scaled_information(joint))
    combinations = []
    for k in np.flatnonzero(values < 1 / UNDETERMINED_SPANS**2):
        vector = vectors[:, k]
        order = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > _MIN_COMPONENT]
        sign = 1.0 if vector[order[0]] > 0 else -1.0
        terms = [f"{sign * vector[i]:+.2f} {problem.unknowns[i].parameter.name}" for i in order]
        combinations.append(" ".join(terms))
    return tuple(combinations)


def _span_factors(solution: Solution) -> Array:
    """Factors (n,) from the spans at the start to the spans at the solution."""
    out: Array = np.maximum(1.0, _SPAN_PER_DISTANCE * np.abs(solution.z))
    return out


def _scaled_information(solution: Solution) -> Array:
    """The information (n, n) in the spans at the solution.

    A start that is wrong by an order of magnitude has a span that is too small by as much. In units of that span a
    well-determined parameter would appear undetermined, and would be fixed at the wrong start.
    """
    factors = _span_factors(solution)
    return solution.information * np.outer(factors, factors)


def _std(information: Array) -> Array:
    """Standard deviations (n,) in spans; very large without information."""
    return np.sqrt(np.diagonal(covariance_of(information)))


def _fix_undetermined(
    problem: LeastSquaresProblem, joint: Solution, nuisances: Collection[str]
) -> tuple[Solution, dict[int, Verdict]]:
    """Fix undetermined unknowns at their start and refit the others; return the fit and the verdict of each fixed one.

    The refit may move to a region where further unknowns are undetermined, so this is repeated. Nuisance parameters,
    which have a prior, are never fixed.
    """
    solution, fixed = joint, dict[int, Verdict]()
    free = [i for i, unknown in enumerate(problem.unknowns) if unknown.parameter.name not in nuisances]
    beside = [i for i in range(len(problem.unknowns)) if i not in free]
    while more := _undetermined(solution, [i for i in free if i not in fixed], beside):
        fixed |= more
        at = np.array([0.0 if i in fixed else value for i, value in enumerate(joint.z)])
        solution = problem.solve(at, sorted(fixed))
    return solution, fixed


def _undetermined(solution: Solution, only: list[int], beside: list[int]) -> dict[int, Verdict]:
    """Which of the unknowns `only` to fix, with the verdict, so that the others are determined; worst first.

    beside: unknowns that are uncertain, too, but not fixed.
    """
    fixed: dict[int, Verdict] = {}
    information = _scaled_information(solution)
    while only:
        part = [*only, *beside]
        std = _std(information[np.ix_(part, part)])[: len(only)]
        worst = int(np.argmax(std))
        if std[worst] <= UNDETERMINED_SPANS:
            break
        i = only.pop(worst)
        alone = information[i, i]
        fixed[i] = (
            Verdict.NO_EFFECT if alone < 1e-6
            else Verdict.UNDECIDED if alone < 1 / UNDETERMINED_SPANS**2
            else Verdict.ENTANGLED
        )  # fmt: skip
    return fixed


def _estimates(
    problem: LeastSquaresProblem,
    solution: Solution,
    joint: Solution,
    fixed: Mapping[int, Verdict],
    nuisances: Collection[str],
    wide: Array,
) -> tuple[tuple[Estimate, ...], Array]:
    n = len(problem.unknowns)
    only = [i for i in range(n) if i not in fixed]
    rates = problem.rates(solution.z)
    scaled = _scaled_information(joint)
    joint_std = _std(scaled + np.eye(n) / _PRIOR_SPANS**2)
    wide_std = joint_std * _span_factors(joint)
    covariance = np.zeros((n, n))
    covariance[np.ix_(only, only)] = wide[np.ix_(only, only)]
    prior_std = 1 / np.sqrt(np.maximum(np.diagonal(solution.prior_information), 1e-300))
    out = []
    for i, unknown in enumerate(problem.unknowns):
        verdict = fixed.get(i, Verdict.IDENTIFIED)
        nuisance = unknown.parameter.name in nuisances
        if i not in fixed and not nuisance and joint_std[i] > UNDETERMINED_SPANS:
            verdict = Verdict.ENTANGLED
        std = float(np.sqrt(covariance[i, i]))
        if verdict is Verdict.IDENTIFIED and std > _PRIOR_ONLY_RATIO * prior_std[i]:
            verdict = Verdict.PRIOR
        partners = _partners(scaled, i) if verdict is Verdict.ENTANGLED else []
        estimate = _estimate(problem, unknown, float(solution.z[i]), std, verdict, partners, float(wide_std[i]))
        out.append(replace(estimate, nuisance=nuisance))
    return tuple(out), covariance * np.outer(rates, rates)


def _joint_covariance(problem: LeastSquaresProblem, solution: Solution, fixed: Iterable[int]) -> tuple[Array, Array]:
    """Information (n,) that is assumed of the fixed unknowns, and the covariance (n, n) of all with it, in spans.

    It gives each of them, worst first, an error of `UNDETERMINED_SPANS` together with what the data say of it: that of
    the least determined unknown that is not fixed. With a fixed amount, more data could widen error bars.
    """
    every = range(len(problem.unknowns))
    assumed = np.zeros(len(every))
    if not fixed:
        return assumed, covariance_of(solution.information)
    whole = problem.solution(solution.z, every, solution.weights, solution.discrepancy, solution.solved)
    left = list(every)
    for i in fixed:
        std = _std(whole.information[np.ix_(left, left)])[left.index(i)]
        assumed[i] = max(0.0, 1 / UNDETERMINED_SPANS**2 - 1 / std**2)
        left.remove(i)
    return assumed, covariance_of(whole.information + np.diag(assumed))


def _partners(information: Array, i: int) -> list[int]:
    """The other unknowns that must be known to determine unknown i.

    Greedy: conditions on the one that reduces the variance most, until it is determined. If several suffice alone, all
    of them are returned.
    """
    n, enough = len(information), UNDETERMINED_SPANS**2
    covariance = np.linalg.inv(information + np.eye(n) / _PRIOR_SPANS**2)
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


def _estimate(
    problem: LeastSquaresProblem,
    unknown: Unknown,
    z: float,
    std: float,
    verdict: Verdict,
    partners: list[int],
    joint_std: float,
) -> Estimate:
    parameter = unknown.parameter
    used, rate = unknown.at(z), unknown.rate(z)
    known = verdict is Verdict.IDENTIFIED
    interval = (unknown.at(z - NORMAL_95 * std), unknown.at(z + NORMAL_95 * std))
    return Estimate(
        name=parameter.name,
        unit=parameter.unit,
        run="" if unknown.run is None else problem.data[unknown.run].run_id,
        used=used,
        value=used if known else None,
        std=std * rate if known else None,
        interval=interval if known else None,
        verdict=verdict,
        partners=tuple(dict.fromkeys(problem.unknowns[j].parameter.name for j in partners)),
        joint_std=joint_std * rate,
    )


def _runs(problem: LeastSquaresProblem, solution: Solution) -> tuple[RunFit, ...]:
    predicted, at_start = problem.predicted(solution.z), problem.predicted(np.zeros(len(solution.z)))
    gaps = problem.gaps(solution.z)
    out = []
    for run, poses in enumerate(problem.data):
        residual = whitened(poses, gaps[run], solution.weights[run])
        out.append(
            RunFit(
                run_id=poses.run_id,
                source=poses.source,
                moving=poses.moving,
                frames=int(poses.frames[poses.has_tip].sum()),
                gap=gaps[run],
                predicted_m=predicted[run],
                before_m=at_start[run] if poses.live_m is None else poses.live_m,
                outliers=int(outlying(residual).sum()),
                oriented=int(poses.frames[poses.has_orientation].sum()),
                correlation=solution.correlation[run],
                setup=problem.setup(solution.z, run),
                before_live=poses.live_m is not None,
                drifting=poses.in_sequence and drifting(residual),
            )
        )
    return tuple(out)
