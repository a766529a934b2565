"""Was the larger model worth it? Candidates compared by prediction of runs left out and by information criteria."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import model
from calibration.identify.data import NoDataError, Poses
from calibration.identify.fit import identify
from calibration.identify.held_out_prediction import with_zeros
from calibration.identify.least_squares import Problem
from calibration.identify.parallel_map import Progress, parallel_map
from calibration.identify.parameters import Prior, Setup, named
from calibration.identify.tip_predictor import SUBSTEPS, Predictor

Array = NDArray[np.float64]

# Differences of a criterion below this are not worth a sentence (Burnham and Anderson's rule of thumb).
_WORTH = 10.0
_DAMPED_FROM_S = 0.01
DAMPING = "damping_s"
# Up to so many runs each is left out by itself; of more, so many groups in turn.
_FOLDS = 10
# What is compared of each run, so that the slow candidates end too: frames of a motion from its beginning, or poses.
_MOST_FRAMES, _MOST_POSES = 2000, 300
# Numbers of a whole fit before its values.
_FACTS = 4


@dataclass(frozen=True)
class Candidate:
    """One model in the comparison: the setup it starts from, and what is free in it."""

    name: str
    start: Setup
    free: tuple[str, ...]

    def without_damping(self) -> Candidate:
        """The same with damping held at zero, free or not."""
        return replace(self, start=_with_damping(self.start, 0.0), free=tuple(n for n in self.free if n != DAMPING))

    def damped(self) -> Candidate:
        """The same with damping free; where the start has none, from a hundredth of a second."""
        start = self.start if self.start.arm.material.damping_s else _with_damping(self.start, _DAMPED_FROM_S)
        return replace(self, start=start, free=(*(n for n in self.free if n != DAMPING), DAMPING))

    @property
    def damping(self) -> bool:
        """Whether the arm's walls take energy away."""
        return self.start.arm.material.damping_s > 0

    @property
    def inhomogeneous(self) -> bool:
        """First column of Table 3."""
        return self.start.arm.variant.startswith("inhomogeneous")

    @property
    def radial(self) -> bool:
        """Second column of Table 3."""
        return self.start.arm.variant != "homogeneous"


@dataclass(frozen=True)
class ComparisonRow:
    """One line of the table.

    error_percent: mean distance of a left-out run's tips from their prediction over the tip's own excursion, as in
    Table 3. error_m: the same distance, rms. dof: fitted numbers. damping_s: what the data say of it, if they do.
    """

    candidate: Candidate
    error_percent: float
    error_m: float
    aic: float
    bic: float
    dof: int
    damping_s: float | None


@dataclass(frozen=True)
class ModelComparison:
    """The comparison: rows in the order asked, the best by left-out error, and what follows."""

    rows: tuple[ComparisonRow, ...]
    best: ComparisonRow
    sentence: str


def candidates(setup: Setup, free: Iterable[str] = (), moving: bool = False) -> tuple[Candidate, ...]:
    """The paper's three models, the inhomogeneous one by each rule for E_i.

    Where runs move, each stands there twice: without damping, and with a damping that is fitted. Where nothing moves
    damping does not show.
    """
    extra = tuple(free)
    linear, law = ("youngs_modulus_pa", *extra), ("a1_per_n", "a2_per_n2", *extra)

    def of(variant: model.arm.Variant, rule: model.arm.ModulusRule = "pointwise") -> Setup:
        return replace(setup, arm=replace(setup.arm, variant=variant, modulus_rule=rule))

    out = [
        Candidate("homogeneous", of("homogeneous"), linear),
        Candidate("homogeneous+rpe", of("homogeneous+rpe"), (*linear, "rpe_per_bar")),
    ]
    rules: tuple[model.arm.ModulusRule, ...] = ("pointwise", "secant", "tangent", "paper-secant", "paper-tangent")
    out += [Candidate(f"inhomogeneous+rpe, {r}", of("inhomogeneous+rpe", r), (*law, "rpe_per_bar")) for r in rules]
    return tuple(one for still in out for one in (still.without_damping(), still.damped())) if moving else tuple(out)


def _with_damping(setup: Setup, damping_s: float) -> Setup:
    material = replace(setup.arm.material, damping_s=damping_s)
    return replace(setup, arm=replace(setup.arm, material=material))


@dataclass(frozen=True)
class ComparisonFit:
    """One task: a candidate fitted to some runs, from where, and the runs that it is to predict then."""

    candidate: Candidate
    data: tuple[Poses, ...]
    priors: tuple[tuple[str, Prior], ...]
    begin: tuple[tuple[str, str, float], ...] = ()
    unseen: tuple[Poses, ...] = ()


def choose(
    data: Sequence[Poses],
    asked: Sequence[Candidate],
    priors: Mapping[str, Prior] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
) -> ModelComparison:
    """Fit every candidate to all runs, and to all but one in turn to predict that one; of many runs, all but a group.

    The rest is as in `spread`.

    Raises:
        NoData: fewer than two runs.
    """
    if len(data) < 2:
        raise NoDataError("models are compared by predicting runs left out: give at least two runs")
    folds = min(len(data), _FOLDS)
    total = len(asked) * (1 + folds)

    def done(before: int) -> Progress | None:
        return None if progress is None else lambda now, _: progress(before + now, total)

    known = tuple((priors or {}).items())
    wholes = [ComparisonFit(candidate, tuple(data), known) for candidate in asked]
    # The slow candidates stand last in the table and are begun first, so that no core is left with one in the end.
    fitted = parallel_map(whole, wholes[::-1], workers, scheduler, store, done(0))[::-1]
    names = [_unknowns(task) for task in wholes]
    parts = [
        ComparisonFit(
            task.candidate,
            tuple(poses for k, poses in enumerate(data) if k % folds != fold),
            known,
            tuple((*of, value) for of, value in zip(unknowns, found[_FACTS:].tolist(), strict=True)),
            tuple(data[fold::folds]),
        )
        for task, unknowns, found in zip(wholes, names, fitted, strict=True)
        for fold in range(folds)
    ]
    missed = parallel_map(unseen, parts[::-1], workers, scheduler, store, done(len(asked)))[::-1]
    rows = tuple(
        _row(candidate, found, np.concatenate(missed[k * folds : (k + 1) * folds], axis=1))
        for k, (candidate, found) in enumerate(zip(asked, fitted, strict=True))
    )
    best = min(rows, key=lambda row: row.error_m)
    return ModelComparison(rows, best, sentence(rows, best))


def compared(poses: Poses) -> Poses:
    """What of a run is compared: a motion's beginning, or poses evenly spaced, where there are very many."""
    count = len(poses)
    if poses.moving:
        chosen = np.arange(min(count, _MOST_FRAMES))
    else:
        chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_POSES)).round().astype(int))
    return poses if len(chosen) == count else poses.only(chosen)


def excursion(poses: Poses) -> Array:
    """How far each tip (K,) [m] lies from where the arm stood with the least pressure and weight."""
    effort = np.abs(poses.pressure_pa).sum(axis=1) / 1e5 + poses.weight_kg
    rest = poses.tip_m[np.flatnonzero(poses.seen)[np.argmin(effort[poses.seen])]]
    out: Array = np.linalg.norm(poses.tip_m - rest, axis=1)
    return out


def whole(task: ComparisonFit) -> Array:
    """AIC, BIC, fitted numbers and damping (NaN: undecided) of a fit to all runs, then the value of each unknown."""
    fit = identify(task.data, task.candidate.start, task.candidate.free, dict(task.priors), substeps=SUBSTEPS)
    damping = next((e.value for e in fit.estimates if e.name == DAMPING), None)
    facts = [fit.aic, fit.bic, float(fit.fitted), np.nan if damping is None else damping]
    return np.array(facts + [e.used for e in fit.estimates])


def unseen(task: ComparisonFit) -> Array:
    """Distances [m] from each tip of the unseen runs to its prediction, and the same over their run's excursion."""
    begin = {(name, run): value for name, run, value in task.begin}
    candidate = task.candidate
    fit = identify(task.data, candidate.start, candidate.free, dict(task.priors), begin=begin, substeps=SUBSTEPS)
    setup, found = with_zeros(fit), []
    for poses in task.unseen:
        moved, seen = excursion(poses), poses.seen
        error = np.linalg.norm(poses.tip_m - Predictor(poses)(setup), axis=1)
        # A model without a solution foretells no more than an arm that stays where it was.
        error = np.where(np.isfinite(error), error, moved)[seen]
        found.append(np.stack([error, error / moved[seen].max()]))
    return np.concatenate(found, axis=1)


def _unknowns(task: ComparisonFit) -> list[tuple[str, str]]:
    """Name and run of each unknown, in the order of `whole`."""
    start = task.candidate.start
    problem = Problem(task.data, start, named(task.candidate.free, start.arm.geometry.actuators))
    return [(u.parameter.name, "" if u.run is None else task.data[u.run].run_id) for u in problem.unknowns]


def _row(candidate: Candidate, found: Array, missed: Array) -> ComparisonRow:
    aic, bic, dof, damping = found[:_FACTS].tolist()
    return ComparisonRow(
        candidate=candidate,
        error_percent=float(100 * missed[1].mean()),
        error_m=float(np.sqrt((missed[0] ** 2).mean())),
        aic=aic,
        bic=bic,
        dof=int(dof),
        damping_s=None if np.isnan(damping) else damping,
    )


def sentence(rows: Sequence[ComparisonRow], best: ComparisonRow) -> str:
    """What follows from a comparison in which `best` predicts runs left out best; where the whole fits object, that."""
    name = _named(rows)
    said = f"{name(best)} predicts runs left out best: {best.error_m * 1e3:.3g} mm rms"
    simpler = [r for r in rows if r.dof < best.dof]
    if simpler:
        rival = min(simpler, key=lambda row: row.error_m)
        gain = 100 * (1 - best.error_m / rival.error_m)
        worth = rival.bic - best.bic
        said += f", {gain:.0f} % less than {name(rival)} ({rival.error_m * 1e3:.3g} mm)"
        if worth > _WORTH:
            said += f"; the data pay for the larger model (BIC lower by {worth:.0f})"
        else:
            said += f"; but the data do not pay for it (BIC {'lower' if worth > 0 else 'higher'} by {abs(worth):.0f})"
    said += "."
    fittest = min(rows, key=lambda row: row.bic)
    if (better := best.bic - fittest.bic) > _WORTH and fittest not in simpler:
        said += (
            f" All runs together {name(fittest)} meets better (BIC lower by {better:.0f}): the runs are too few, or "
        )
        said += "too different, for each to be predicted from the others."
    return said


def _named(rows: Sequence[ComparisonRow]) -> Callable[[ComparisonRow], str]:
    """How rows are called in the sentence: by their damping, too, where they differ in it."""
    differ = len({row.candidate.damping for row in rows}) > 1

    def name(row: ComparisonRow) -> str:
        damping = ("with damping" if row.candidate.damping else "without damping") if differ else ""
        return f"{row.candidate.name} {damping}".rstrip()

    return name
