"""Identification: from poses to parameters with error bars, or a verdict why there are none."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.identify.errors import NoDataError
from calibration.identify.fitting.noise import NOISE_MODELS, OUTLIER, Noise, NoiseModel, distances
from calibration.identify.fitting.objective import Objective
from calibration.identify.fitting.results import (
    NORMAL_95,
    Estimate,
    Fit,
    RunFit,
    SectionFit,
    Verdict,
    with_means_of_runs,
)
from calibration.identify.observations.poses import Poses
from calibration.identify.prediction.forward_model import ForwardModel
from calibration.identify.unknowns.nuisance import nuisance_parameters
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.parameters import named
from calibration.identify.unknowns.section_mounts import mount_priors
from calibration.identify.unknowns.setup import Setup
from calibration.identify.unknowns.unknown import Unknown, unknowns_of, with_own_values
from model.arrays import Array

Progress = Callable[[str], None]
"""Called with a short text about the state of the search."""

# Most rounds of a search: each minimises the objective with the noise that the residuals of the round before show.
_ROUNDS = 6
# The data leave open what has a larger standard deviation, in spans, or of whose variance a larger share comes from
# spans that nobody stated; they leave to its prior what they hardly narrow.
OPEN_SPANS, _UNSTATED_SHARE, _PRIOR_ONLY = 0.5, 0.9, 0.95
# Far from its start, the span of an unknown is this share of the distance: a start far too small is no yardstick.
_SPAN_PER_DISTANCE = 0.5
# An unknown has no effect where the data alone leave it so many spans; partners exchange above this correlation.
_NO_EFFECT_SPANS, _EXCHANGED = 1e3, 0.4
# An undamped arm rings in a way that no real one does, and the search would follow the ringing.
_TYPICAL_DAMPING_S = 0.01
# Residuals that correlate over a larger share of a run drift.
_DRIFT_SHARE = 0.1


def identify(
    data: Sequence[Poses],
    start: Setup,
    free: Iterable[str],
    priors: Mapping[str, Prior] | None = None,
    initial_values: Mapping[tuple[str, str], float] | None = None,
    substeps: int = 0,
    stated: Mapping[str, Prior] | None = None,
    per_run: Iterable[str] = (),
    progress: Progress = lambda text: None,
    noise: str = "adaptive",
) -> Fit:
    """The minimum of the objective over the unknowns of all runs, static and moving ones together.

    priors: by name; a free parameter without one is believed to be within a span of its start. initial_values: by
    (name, run), replace the starting point, for example by a fit to similar data. substeps: see `ForwardModel`. stated:
    value and uncertainty of every parameter, by name. With it, what is not free is estimated, too, with its stated
    value as prior, so that its uncertainty is in all error bars; without it, what is not free is exact. per_run: names
    of parameters, free or not, with a value of their own in each run, as a mounting that was undone between the runs.
    noise: a name of `NOISE_MODELS`.

    Raises:
        NoDataError: no measured tip, or arms with different numbers of actuators.
        UnknownParameter: a name in `free`, `priors` or `per_run`.
    """
    unknowns, statements = unknowns_for(data, start, free, priors or {}, stated, per_run)
    forward = ForwardModel(data, start, unknowns, substeps)
    theta, objective, solved = _search(forward, _first(forward, initial_values or {}), NOISE_MODELS[noise], progress)
    covariance = objective.covariance(theta)
    estimates = tuple(
        replace(one, stated=None if stated is None else statements.get(one.name))
        for one in _estimates(objective, theta, covariance)
    )
    return Fit(
        setup=with_means_of_runs(forward.setup(theta), estimates),
        start=start,
        estimates=estimates,
        theta=theta,
        covariance=covariance,
        runs=_runs(objective, theta),
        objective=objective,
        solved=solved,
        noise_model=noise,
    )


def unknowns_for(
    data: Sequence[Poses],
    start: Setup,
    free: Iterable[str],
    priors: Mapping[str, Prior],
    stated: Mapping[str, Prior] | None,
    per_run: Iterable[str],
) -> tuple[tuple[Unknown, ...], Mapping[str, Prior]]:
    """The unknowns of `identify`, and the stated value of every parameter by name; raises as it does."""
    if not any(poses.has_tip.any() for poses in data):
        raise NoDataError("no run holds a measured tip")
    actuators = data[0].actuators
    if any(poses.actuators != actuators for poses in data):
        raise NoDataError("the runs are of arms with different numbers of actuators")
    parameters = named(free, actuators)
    beside = () if stated is None else nuisance_parameters(start, data, parameters)
    statements = {**mount_priors(data), **(stated or {})}
    given = {p.name: prior for name, prior in priors.items() for p in named([name], actuators)}
    known = {p.name: statements[p.name] for p in beside} | given
    every = with_own_values((*parameters, *beside), per_run, actuators)
    count = len(parameters)
    return unknowns_of(start, len(data), every[:count], every[count:], known), statements


def _first(forward: ForwardModel, values: Mapping[tuple[str, str], float]) -> Array:
    """Where the search begins (n,): at the start, with values by (name, run) in its place where they are given."""
    theta = forward.first.copy()
    for i, one in enumerate(forward.unknowns):
        if one.name == "damping_s" and one.start == 0 and any(poses.moving for poses in forward.data):
            theta[i] = _TYPICAL_DAMPING_S
        run = "" if one.run is None else forward.data[one.run].run_id
        theta[i] = np.clip(values.get((one.name, run), theta[i]), one.lower, one.upper)
    return theta


def _search(
    forward: ForwardModel, first: Array, model: NoiseModel, progress: Progress
) -> tuple[Array, Objective, bool]:
    """The minimum, its objective and whether the search converged, in rounds until the noise stays the same."""
    theta, noise, solved = first, model.first(forward), False
    for number in range(1, _ROUNDS + 1):
        theta, solved = Objective(forward, noise).minimum(theta, _shown(forward, number, progress))
        before, noise = noise, model.at(forward, theta, _determined(forward, noise, theta))
        if noise.close_to(before):
            break
    objective = Objective(forward, noise)
    if objective.value(first) < objective.value(theta):
        # The rounds have left the start for a worse minimum of what counts in the end.
        theta, solved = objective.minimum(first, _shown(forward, _ROUNDS + 1, progress))
    return theta, objective, solved


def _shown(forward: ForwardModel, number: int, progress: Progress) -> Callable[[Array], None]:
    """What a round calls after each step."""
    step = 0

    def show(theta: Array) -> None:
        nonlocal step
        step += 1
        progress(f"one start, round {number}, step {step}: rms {1e3 * forward.rms_m(theta):.3f} mm")

    return show


def _determined(forward: ForwardModel, noise: Noise, theta: Array) -> float:
    """How many unknowns the data determine: a narrow prior leaves them nothing to determine."""
    share = np.diagonal(Objective(forward, noise).covariance(theta)) / forward.std**2
    return float((1 - np.minimum(share, 1.0)).sum())


def _estimates(objective: Objective, theta: Array, covariance: Array) -> list[Estimate]:
    forward = objective.forward
    slopes = objective.slopes(theta)[: -len(theta)]
    information = (slopes**2).sum(axis=0)
    std = np.sqrt(np.diagonal(covariance))
    related = covariance / np.outer(std, std)
    unstated = np.array([not one.stated for one in forward.unknowns])
    shares = ((related * std / forward.std) ** 2)[:, unstated].sum(axis=1)
    out = []
    for i, one in enumerate(forward.unknowns):
        value, bar = float(theta[i]), float(std[i])
        span = max(one.span, _SPAN_PER_DISTANCE * abs(value - one.start))
        interval = max(value - NORMAL_95 * bar, one.lower), min(value + NORMAL_95 * bar, one.upper)
        is_open = bar > OPEN_SPANS * span or shares[i] > _UNSTATED_SHARE
        verdict = _verdict(one, is_open, float(information[i]) * span**2, bar / one.std, interval)
        known = verdict is Verdict.IDENTIFIED
        order = np.argsort(-np.abs(related[i])) if verdict is Verdict.ENTANGLED else ()
        partners = [forward.unknowns[j].name for j in order if j != i and abs(related[i, j]) > _EXCHANGED]
        out.append(
            Estimate(
                name=one.name,
                unit=one.parameter.unit,
                run="" if one.run is None else forward.data[one.run].run_id,
                used=value,
                value=value if known else None,
                std=bar if known else None,
                interval=interval if known else None,
                verdict=verdict,
                partners=tuple(dict.fromkeys(name for name in partners if name != one.name)),
                posterior_std=bar,
                nuisance=not one.free,
                prior=Prior(one.mean, one.std) if one.stated else None,
            )
        )
    return out


def _verdict(
    one: Unknown, is_open: bool, information: float, of_prior: float, interval: tuple[float, float]
) -> Verdict:
    """information: of the data alone, in spans; of_prior: the bar over the standard deviation of the prior."""
    if one.stated and of_prior > _PRIOR_ONLY:
        return Verdict.PRIOR
    if one.free and information < _NO_EFFECT_SPANS**-2:
        return Verdict.NO_EFFECT
    if one.free and is_open:
        return Verdict.ENTANGLED if information > OPEN_SPANS**-2 else Verdict.UNDECIDED
    if one.free and one.parameter.absent_at_zero and interval[0] <= 0 <= interval[1]:
        return Verdict.ABSENT
    return Verdict.IDENTIFIED


def _runs(objective: Objective, theta: Array) -> tuple[RunFit, ...]:
    forward = objective.forward
    predicted, at_start, gaps = forward.predicted(theta), forward.predicted(forward.first), forward.gaps(theta)
    out = []
    for run, (poses, noise) in enumerate(zip(forward.data, objective.noise.runs, strict=True)):
        # An outlier is inflated to a distance at the threshold; correlation makes all distances shorter.
        distance = distances(noise.whitened_gap(gaps[run])) * np.sqrt(noise.correlation)
        out.append(
            RunFit(
                run_id=poses.run_id,
                source=poses.source,
                moving=poses.moving,
                frames=int(poses.frames[poses.has_tip].sum()),
                gap=gaps[run],
                predicted_m=predicted[run],
                before_m=at_start[run] if poses.live_m is None else poses.live_m,
                outliers=int((distance >= OUTLIER * (1 - 1e-9)).any(axis=1).sum()),
                oriented=int(poses.frames[poses.has_orientation].sum()),
                correlation=noise.correlation,
                independent=poses.independent / noise.correlation,
                setup=forward.setup(theta, run),
                before_live=poses.live_m is not None,
                drifting=poses.in_sequence and noise.correlation > _DRIFT_SHARE * len(poses),
                sections=SectionFit.every(poses, gaps[run]),
            )
        )
    return tuple(out)
