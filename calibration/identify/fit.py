"""Maximum-likelihood identification: from poses to parameters with error bars, or a verdict why there are none."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.identify.errors import NoDataError
from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import drifting, outlying, whitened
from calibration.identify.nuisance import nuisance_parameters
from calibration.identify.parameter import Prior
from calibration.identify.parameters import named
from calibration.identify.poses import Poses
from calibration.identify.results import NORMAL_95, Estimate, Fit, RunFit, SectionFit, Verdict, with_means_of_runs
from calibration.identify.scaled_parameter import ScaledParameter, with_own_values
from calibration.identify.search import Progress, initial_point, point_of, search
from calibration.identify.section_mounts import mount_priors
from calibration.identify.setup import Setup
from calibration.identify.solution import Solution
from calibration.identify.undetermined import (
    PRIOR_SPANS,
    UNDETERMINED_SPANS,
    HeldUnknown,
    determined_fit,
    open_directions,
    partners_of,
    scaled_information,
    span_factors,
    standard_deviations,
)
from model.arrays import Array

_PRIOR_ONLY_RATIO = 0.95


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
        NoDataError: no measured tip, or arms with different numbers of actuators.
        UnknownParameter: a name in `free`, `priors` or `per_run`.
    """
    problem, stated_priors, nuisances = _problem(data, start, free, priors or {}, stated, per_run, substeps)
    first = initial_point(problem, progress) if initial_values is None else point_of(problem, initial_values)
    searched = search(problem, first, starts, seed, progress)
    joint = searched.best
    found = determined_fit(
        problem, joint, nuisances, with_model_error=stated is not None, hold=hold_undetermined, progress=progress
    )
    solution, fixed, posterior = found.solution, found.held, found.posterior
    wide = posterior.wide
    estimates, covariance = _estimates(problem, solution, joint, fixed, nuisances, wide)
    if stated is not None:
        estimates = tuple(replace(one, stated=stated_priors.get(one.name)) for one in estimates)
    rates = problem.rates(solution.z)
    return Fit(
        setup=with_means_of_runs(problem.setup(solution.z), estimates),
        start=start,
        estimates=estimates,
        covariance=covariance,
        joint_covariance=wide,
        fitted_covariance=posterior.alone * np.outer(rates, rates),
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
        open_directions=open_directions(problem, joint),
        start_losses=searched.losses,
        problem=problem,
        solution=solution,
        model_error=posterior.model_error,
    )


def _problem(
    data: Sequence[Poses],
    start: Setup,
    free: Iterable[str],
    priors: Mapping[str, Prior],
    stated: Mapping[str, Prior] | None,
    per_run: Iterable[str],
    substeps: int,
) -> tuple[LeastSquaresProblem, Mapping[str, Prior], Collection[str]]:
    """The problem, the stated value of every parameter by name, and the names of the nuisance parameters."""
    if not any(poses.has_tip.any() for poses in data):
        raise NoDataError("no run holds a measured tip")
    actuators = data[0].actuators
    if any(poses.actuators != actuators for poses in data):
        raise NoDataError("the runs are of arms with different numbers of actuators")
    parameters = named(free, actuators)
    held = () if stated is None else nuisance_parameters(start, data, parameters)
    stated_priors = {**mount_priors(data), **(stated or {})}
    given = {p.name: prior for name, prior in priors.items() for p in named([name], actuators)}
    known = {p.name: stated_priors[p.name] for p in held} | given
    every = with_own_values((*parameters, *held), per_run, actuators)
    return LeastSquaresProblem(data, start, every, known, substeps=substeps), stated_priors, {p.name for p in held}


def _estimates(
    problem: LeastSquaresProblem,
    solution: Solution,
    joint: Solution,
    fixed: Mapping[int, HeldUnknown],
    nuisances: Collection[str],
    wide: Array,
) -> tuple[tuple[Estimate, ...], Array]:
    n = len(problem.unknowns)
    only = [i for i in range(n) if i not in fixed]
    rates = problem.rates(solution.z)
    scaled = scaled_information(joint.information, joint.z)
    joint_std = standard_deviations(scaled + np.eye(n) / PRIOR_SPANS**2)
    wide_std = joint_std * span_factors(joint.z)
    covariance = np.zeros((n, n))
    covariance[np.ix_(only, only)] = wide[np.ix_(only, only)]
    prior_std = 1 / np.sqrt(np.maximum(np.diagonal(solution.prior_information), 1e-300))
    out = []
    for i, unknown in enumerate(problem.unknowns):
        verdict = fixed[i].verdict if i in fixed else Verdict.IDENTIFIED
        nuisance = unknown.parameter.name in nuisances
        if i not in fixed and not nuisance and joint_std[i] > UNDETERMINED_SPANS:
            verdict = Verdict.ENTANGLED
        std = float(np.sqrt(covariance[i, i]))
        if verdict is Verdict.IDENTIFIED and std > _PRIOR_ONLY_RATIO * prior_std[i]:
            verdict = Verdict.PRIOR
        partners = partners_of(scaled, i) if verdict is Verdict.ENTANGLED else []
        estimate = _estimate(problem, unknown, float(solution.z[i]), std, verdict, partners, float(wide_std[i]))
        out.append(replace(estimate, nuisance=nuisance, prior=problem.priors.get(estimate.name)))
    return tuple(out), covariance * np.outer(rates, rates)


def _estimate(
    problem: LeastSquaresProblem,
    unknown: ScaledParameter,
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
                independent=poses.independent / solution.correlation[run],
                setup=problem.setup(solution.z, run),
                before_live=poses.live_m is not None,
                drifting=poses.in_sequence and drifting(residual),
                sections=SectionFit.every(poses, gaps[run]),
            )
        )
    return tuple(out)
