"""Identification: from poses to parameters with error bars, or to the verdict that they cannot be told."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calibration.identify.data import NoDataError, Poses
from calibration.identify.least_squares import Problem, Solution, Unknown
from calibration.identify.likelihood import OUTLIER, drifting, whitened
from calibration.identify.parameters import Prior, Setup, named

Array = NDArray[np.float64]

NORMAL_95 = 1.959963984540054
# An error bar of this many plausible spans says that the data have not decided.
_UNDECIDED = 0.5
# Of what lies far from its start, spans count as this part of the way: four error bars from there it is no longer open.
_OF_WAY = 0.5
_ONLY_PRIOR = 0.95
_SAME_LOSS = 0.5
# Spans that nothing lies farther off than: what the data leave wholly open stays finite, and does not carry along what
# it hardly touches.
_FAR = 2.0
_SHOWN_SHARE = 0.2


class Verdict(StrEnum):
    """What the data say of one parameter."""

    IDENTIFIED = "identified"
    NO_EFFECT = "no effect on the data"
    UNDECIDED = "the data leave it open"
    ENTANGLED = "only in combination with others"
    PRIOR = "known from its prior alone"


def rms(distance_m: Array) -> float:
    """Root mean square of those distances (K,) [m] that are known; NaN where none is."""
    known = distance_m[np.isfinite(distance_m)]
    return float(np.sqrt((known**2).mean())) if len(known) else math.nan


@dataclass(frozen=True)
class Estimate:
    """One free parameter. `value`, `std` and `interval` are None where it has not been identified.

    used: the value in `Fit.setup`, whatever the verdict. run: whose own value it is, empty for a value of all runs.
    partners: with which others it can be exchanged. loose_std: the standard deviation in the joint fit, for the report.
    """

    name: str
    unit: str
    run: str
    used: float
    value: float | None
    std: float | None
    interval: tuple[float, float] | None
    verdict: Verdict
    partners: tuple[str, ...]
    loose_std: float

    @property
    def identified(self) -> bool:
        """Whether the data tell it."""
        return self.value is not None


@dataclass(frozen=True)
class RunFit:
    """How one run was met. residual_m (K, 3): measured minus predicted, NaN where no tip is. error_m: its length."""

    run_id: str
    source: str
    moving: bool
    frames: int
    residual_m: Array
    predicted_m: Array
    before_m: Array
    """Predictions of the starting setup."""
    outliers: int
    correlation: float
    setup: Setup
    drifting: bool = False
    """Its errors outlast a tenth of it; error bars count them as far as they show."""

    @property
    def error_m(self) -> Array:
        """Distance from measured to predicted (K,), measured entries only."""
        error: Array = np.linalg.norm(self.residual_m, axis=1)
        return error[np.isfinite(error)]

    @property
    def rms_m(self) -> float:
        """Root mean square distance from measured to predicted."""
        return rms(self.error_m)

    @property
    def rms_before_m(self) -> float:
        """The same of the starting setup."""
        return rms(np.linalg.norm(self.residual_m + self.predicted_m - self.before_m, axis=1))


@dataclass(frozen=True)
class Fit:
    """Parameters of an arm.

    setup: with every `used` value (no run's own). covariance (n, n): of the fitted values, in the order of `estimates`,
    zero for what was held, which the others' error bars take to be half a span off. discrepancy_m: by how much,
    per axis, the model is off beyond the stated errors.
    """

    setup: Setup
    start: Setup
    estimates: tuple[Estimate, ...]
    covariance: Array
    runs: tuple[RunFit, ...]
    log_likelihood: float
    loss: float
    discrepancy_m: float
    measured: int
    fitted: int
    starts: int
    agreeing_starts: int
    solved: bool
    open_directions: tuple[str, ...]
    """Combinations of parameters that the data leave open, in words: what the information matrix lacks in rank."""
    start_losses: tuple[float, ...]
    """What the search from each starting point ended at, the best one as zero, twice the log likelihood."""
    problem: Problem = field(repr=False)
    solution: Solution = field(repr=False)

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name, the first run's where each run has its own."""
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise KeyError(name)

    @property
    def held(self) -> tuple[bool, ...]:
        """Which estimates stand at their start because the data do not tell them, in the order of `estimates`."""
        return tuple((np.diagonal(self.covariance) == 0).tolist())

    @property
    def drifts(self) -> str:
        """Of runs whose errors outlast a tenth of them, what it means; empty where there are none."""
        names = ", ".join(run.run_id for run in self.runs if run.drifting)
        return f"what is left of {names} drifts as slowly as the run: error bars may be too narrow" if names else ""

    @property
    def rms_m(self) -> float:
        """Root mean square distance over all measured tips."""
        return rms(np.concatenate([run.error_m for run in self.runs]))

    @property
    def aic(self) -> float:
        """Akaike's criterion; the discrepancy counts as one parameter."""
        return 2 * (self.fitted + 1) - 2 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's criterion, with tips that tell something new for its sample size."""
        new = sum(3 * len(run.error_m) / max(run.correlation, 1.0) for run in self.runs)
        return float((self.fitted + 1) * np.log(max(new, 2.0)) - 2 * self.log_likelihood)


def identify(
    data: Sequence[Poses],
    start: Setup,
    free: Iterable[str],
    priors: Mapping[str, Prior] | None = None,
    starts: int = 1,
    seed: int = 0,
    begin: Mapping[tuple[str, str], float] | None = None,
    substeps: int = 0,
) -> Fit:
    """Maximum likelihood of the free parameters over all runs, static and moving ones together.

    priors: by name. starts: how many starting points; the first is `start`, the others lie around it. begin: values by
    (name, run) that the search begins at instead, say of a fit to nearly the same data; what cannot be told is held at
    `start` even so. substeps: as of `Problem`.

    Raises:
        NoData: no measured tip.
        UnknownParameter: a name in `free` or `priors`.
    """
    if not any(poses.seen.any() for poses in data):
        raise NoDataError("no run holds a measured tip")
    actuators = data[0].actuators
    if any(poses.actuators != actuators for poses in data):
        raise NoDataError("the runs are of arms with different numbers of actuators")
    parameters = named(free, actuators)
    priors = {p.name: prior for name, prior in (priors or {}).items() for p in named([name], actuators)}
    problem = Problem(data, start, parameters, priors, substeps=substeps)
    joint, ends = _best(problem, _first(problem) if begin is None else _at(problem, begin), starts, seed)
    solution, held = _decided(problem, joint)
    estimates, covariance = _estimates(problem, solution, joint, held)
    return Fit(
        setup=problem.setup(solution.z),
        start=start,
        estimates=estimates,
        covariance=covariance,
        runs=_runs(problem, solution),
        log_likelihood=solution.log_likelihood,
        loss=solution.loss,
        discrepancy_m=solution.discrepancy_m,
        measured=problem.measured,
        fitted=len(problem.unknowns) - len(held),
        starts=starts,
        agreeing_starts=sum(end < 2 * _SAME_LOSS for end in ends),
        solved=solution.solved,
        open_directions=_open_directions(problem, joint),
        start_losses=ends,
        problem=problem,
        solution=solution,
    )


def _first(problem: Problem) -> Array:
    """Where to start: at the best answer of the runs at rest, which cost little, where there are any beside others."""
    z = np.zeros(len(problem.unknowns))
    resting = [run for run, poses in enumerate(problem.data) if not poses.moving]
    if len(resting) in (0, len(problem.data)):
        return z
    part = Problem([problem.data[run] for run in resting], problem.start, problem.free, problem.priors)
    found = dict(
        zip(((u.parameter.name, u.run) for u in part.unknowns), part.solve(np.zeros(len(part.unknowns))).z, strict=True)
    )
    for i, unknown in enumerate(problem.unknowns):
        own = resting.index(unknown.run) if unknown.run in resting else None
        if unknown.run is None or own is not None:
            z[i] = found[unknown.parameter.name, own]
    return z


def _at(problem: Problem, values: Mapping[tuple[str, str], float]) -> Array:
    """Values by (name, run), in spans (n,); zero where there is none."""
    z = np.zeros(len(problem.unknowns))
    for i, unknown in enumerate(problem.unknowns):
        run = "" if unknown.run is None else problem.data[unknown.run].run_id
        value = values.get((unknown.parameter.name, run), unknown.start)
        z[i] = np.clip(unknown.of(value), unknown.lower, unknown.upper)
    return z


def _best(problem: Problem, first: Array, starts: int, seed: int) -> tuple[Solution, tuple[float, ...]]:
    rng = np.random.default_rng(seed)
    found = [problem.solve(first)]
    found.extend(problem.solve(_around(problem, first, rng)) for _ in range(starts - 1))
    best = max(found, key=lambda s: s.log_likelihood)
    return best, tuple(2 * (best.log_likelihood - s.log_likelihood) for s in found)


def _around(problem: Problem, first: Array, rng: np.random.Generator) -> Array:
    """Another starting point: half a span about the first one, or decades where a law may be of another order."""
    z = first + rng.uniform(-0.5, 0.5, len(first))
    for i, unknown in enumerate(problem.unknowns):
        decades = unknown.parameter.decades
        if decades:
            z[i] = unknown.of(unknown.at(float(first[i])) * 10 ** rng.uniform(-decades, decades))
        z[i] = np.clip(z[i], unknown.lower, unknown.upper)
    return z


def _open_directions(problem: Problem, joint: Solution) -> tuple[str, ...]:
    """Directions, in spans, along which the data leave half a span or more open."""
    values, vectors = np.linalg.eigh(_judged(joint))
    said = []
    for k in np.flatnonzero(values < 1 / _UNDECIDED**2):
        vector = vectors[:, k]
        order = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > _SHOWN_SHARE]
        sign = 1.0 if vector[order[0]] > 0 else -1.0
        terms = [f"{sign * vector[i]:+.2f} {problem.unknowns[i].parameter.name}" for i in order]
        said.append(" ".join(terms))
    return tuple(said)


def _stretched(solution: Solution) -> Array:
    """By how much (n,) the spans by which unknowns are judged are longer than those that they are counted in."""
    out: Array = np.maximum(1.0, _OF_WAY * np.abs(solution.z))
    return out


def _judged(solution: Solution) -> Array:
    """The information (n, n) in the spans by which unknowns are judged.

    A start that is wrong by an order of magnitude has a span that is too small by as much: in these the data would
    leave open what they tell, and it would be held where they say that it is not.
    """
    stretched = _stretched(solution)
    return solution.information * np.outer(stretched, stretched)


def _std(information: Array) -> Array:
    """Standard deviations (n,) in spans; what has no information gets a very large one."""
    return np.sqrt(np.diagonal(_inverse(information)))


def _inverse(information: Array) -> Array:
    """Covariance of an information matrix, finite where it is singular."""
    values, vectors = np.linalg.eigh(information)
    floor = max(1e-8, 1e-14 * float(values.max(initial=0.0)))
    out: Array = (vectors / np.maximum(values, floor)) @ vectors.T
    return out


def _decided(problem: Problem, joint: Solution) -> tuple[Solution, dict[int, Verdict]]:
    """The fit in which what the data do not tell is held at its start, and why each of these is held.

    Without them the rest may lie elsewhere, where the data tell less: it is judged again there.
    """
    solution, held = joint, dict[int, Verdict]()
    while more := _undecided(solution, [i for i in range(len(problem.unknowns)) if i not in held]):
        held |= more
        at = np.array([0.0 if i in held else value for i, value in enumerate(joint.z)])
        solution = problem.solve(at, sorted(held))
    return solution, held


def _undecided(solution: Solution, only: list[int]) -> dict[int, Verdict]:
    """Which of the unknowns `only` to hold so that the rest of them are decided, and why."""
    held: dict[int, Verdict] = {}
    information = _judged(solution)
    while only:
        std = _std(information[np.ix_(only, only)])
        worst = int(np.argmax(std))
        if std[worst] <= _UNDECIDED:
            break
        i = only.pop(worst)
        alone = information[i, i]
        held[i] = (
            Verdict.NO_EFFECT if alone < 1e-6
            else Verdict.UNDECIDED if alone < 1 / _UNDECIDED**2
            else Verdict.ENTANGLED
        )  # fmt: skip
    return held


def _estimates(
    problem: Problem, solution: Solution, joint: Solution, held: Mapping[int, Verdict]
) -> tuple[tuple[Estimate, ...], Array]:
    n = len(problem.unknowns)
    only = [i for i in range(n) if i not in held]
    rates = problem.rates(solution.z)
    judged = _judged(joint)
    loose = _std(judged + np.eye(n) / _FAR**2)
    far = loose * _stretched(joint)
    covariance = np.zeros((n, n))
    covariance[np.ix_(only, only)] = _marginal(problem, solution, only)
    prior_std = 1 / np.sqrt(np.maximum(np.diagonal(solution.prior_information), 1e-300))
    out = []
    for i, unknown in enumerate(problem.unknowns):
        verdict = held.get(i, Verdict.IDENTIFIED)
        if i not in held and loose[i] > _UNDECIDED:
            verdict = Verdict.ENTANGLED
        std = float(np.sqrt(covariance[i, i]))
        if verdict is Verdict.IDENTIFIED and std > _ONLY_PRIOR * prior_std[i]:
            verdict = Verdict.PRIOR
        partners = _partners(judged, i) if verdict is Verdict.ENTANGLED else []
        out.append(_estimate(problem, unknown, float(solution.z[i]), std, verdict, partners, float(far[i])))
    return tuple(out), covariance * np.outer(rates, rates)


def _marginal(problem: Problem, solution: Solution, only: list[int]) -> Array:
    """Covariance of the unknowns `only`, in spans, where each of the others may lie `_UNDECIDED` of a span off."""
    if len(only) == len(problem.unknowns):
        return _inverse(solution.information)
    every = range(len(problem.unknowns))
    whole = problem.solution(solution.z, every, solution.weights, solution.discrepancy_m, solution.solved)
    guessed = np.diag([0.0 if i in only else 1 / _UNDECIDED**2 for i in every])
    return _inverse(whole.information + guessed)[np.ix_(only, only)]


def _partners(information: Array, i: int) -> list[int]:
    """Which others would have to be known for unknown i to be decided.

    One after the other that helps most; where several would each do alone, as what can be exchanged does, all of them.
    """
    n, enough = len(information), _UNDECIDED**2
    covariance = np.linalg.inv(information + np.eye(n) / _FAR**2)
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
    problem: Problem, unknown: Unknown, z: float, std: float, verdict: Verdict, partners: list[int], loose: float
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
        loose_std=loose * rate,
    )


def _runs(problem: Problem, solution: Solution) -> tuple[RunFit, ...]:
    predicted, before = problem.predicted(solution.z), problem.predicted(np.zeros(len(solution.z)))
    out = []
    for run, poses in enumerate(problem.data):
        residual = whitened(poses, predicted[run], solution.weights[run])
        out.append(
            RunFit(
                run_id=poses.run_id,
                source=poses.source,
                moving=poses.moving,
                frames=int(poses.frames[poses.seen].sum()),
                residual_m=poses.tip_m - predicted[run],
                predicted_m=predicted[run],
                before_m=before[run],
                outliers=int((np.linalg.norm(residual[poses.seen], axis=1) > OUTLIER).sum()),
                correlation=solution.correlation[run],
                setup=problem.setup(solution.z, run),
                drifting=poses.in_sequence and drifting(residual),
            )
        )
    return tuple(out)
