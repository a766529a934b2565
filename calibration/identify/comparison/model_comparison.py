"""Comparison of models by cross-validation over runs and by information criteria (AIC, BIC)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.identify.comparison.candidates import DAMPING, Candidate
from calibration.identify.errors import NoDataError
from calibration.identify.fitting.fit import identify, unknowns_for
from calibration.identify.fitting.results import Fit
from calibration.identify.observations.poses import Poses
from calibration.identify.prediction.tip_predictor import SUBSTEPS, Predictor
from calibration.identify.unknowns.parameter import Prior
from calibration.parallel_map import Progress, parallel_map
from model.arrays import Array
from model.units import PA_PER_BAR

# A smaller difference of a criterion is no evidence (rule of thumb of Burnham and Anderson).
_MIN_BIC_GAIN = 10.0
# Share of the held-out error by which a memory must lower it: a branch or stop of no effect wins half of all ties.
_MEMORY_GAIN = 0.05
# Leave-one-out for up to this many runs, else this many folds.
_FOLDS = 10
# Parts of equal length that a single run is divided into, each left out once; and the fewest tips of such a run.
_PARTS, _FEWEST_TIPS = 5, 10
# Differences of BIC below which the data do not decide between two models (Kass and Raftery 1995).
MIN_DECISIVE = 2.0
# Most data per run, to bound the time of slow candidates: first frames of a motion, or poses.
_MAX_FRAMES, _MAX_POSES = 2000, 300
# Numbers in the result of `fit_all` before the values.
_FACTS = 4


@dataclass(frozen=True)
class ComparisonRow:
    """One line of the table.

    error_percent: mean distance of left-out tips from their prediction over the tip's own excursion, as in
    Table 3. error_m: the same distance, rms. dof: fitted numbers. damping_s: estimate, None if not identified.
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
    """The comparison: rows in the order of the candidates, the best by held-out error, and the conclusion."""

    rows: tuple[ComparisonRow, ...]
    best: ComparisonRow
    sentence: str


@dataclass(frozen=True)
class HeldOut:
    """Tips to predict: a run, and which of its entries (K,) were left out of the fit."""

    poses: Poses
    entries: NDArray[np.bool_]


@dataclass(frozen=True)
class Fold:
    """One division of the data: what is fitted, and what is predicted."""

    fitted: tuple[Poses, ...]
    held_out: tuple[HeldOut, ...]


@dataclass(frozen=True)
class ComparisonFit:
    """One task: a candidate, the runs to fit, initial values, and the tips to predict.

    stated: value and uncertainty of what is not free, by name; without it, these numbers are exact.
    """

    candidate: Candidate
    data: tuple[Poses, ...]
    priors: tuple[tuple[str, Prior], ...]
    initial_values: tuple[tuple[str, str, float], ...] = ()
    held_out: tuple[HeldOut, ...] = ()
    stated: tuple[tuple[str, Prior], ...] | None = None

    def fit(self) -> Fit:
        """The fit of the candidate to the data."""
        return identify(
            self.data,
            self.candidate.start,
            self.candidate.free,
            dict(self.priors),
            initial_values={(name, run): value for name, run, value in self.initial_values} or None,
            substeps=SUBSTEPS,
            stated=None if self.stated is None else dict(self.stated),
        )


def compare_models(
    data: Sequence[Poses],
    models: Sequence[Candidate],
    priors: Mapping[str, Prior] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
    stated: Mapping[str, Prior] | None = None,
) -> ModelComparison:
    """Fit every candidate to all runs, and cross-validate it over runs (leave-one-out, or `_FOLDS` folds).

    A single run is divided into `_PARTS` parts in time. stated: as for `identify`. The other arguments are those of
    `parallel_map`.

    Raises:
        NoDataError: no run, or a single one with too few tips.
    """
    folds = _folds(data)
    total = len(models) * (1 + len(folds))

    def done(before: int) -> Progress | None:
        return None if progress is None else lambda now, _: progress(before + now, total)

    known, numbers = tuple((priors or {}).items()), None if stated is None else tuple(stated.items())
    wholes = [ComparisonFit(candidate, tuple(data), known, stated=numbers) for candidate in models]
    # The slow candidates are last in the table and start first, to balance the load of the cores.
    fitted = parallel_map(fit_all, wholes[::-1], workers, scheduler, store, done(0))[::-1]
    names = [_unknowns(task) for task in wholes]
    parts = [
        ComparisonFit(
            task.candidate,
            fold.fitted,
            known,
            tuple((*of, value) for of, value in zip(unknowns, found[_FACTS:].tolist(), strict=True)),
            fold.held_out,
            numbers,
        )
        for task, unknowns, found in zip(wholes, names, fitted, strict=True)
        for fold in folds
    ]
    errors = parallel_map(prediction_errors, parts[::-1], workers, scheduler, store, done(len(models)))[::-1]
    rows = tuple(
        _row(candidate, found, np.concatenate(errors[k * len(folds) : (k + 1) * len(folds)], axis=1))
        for k, (candidate, found) in enumerate(zip(models, fitted, strict=True))
    )
    best = best_of(rows)
    text = sentence(rows, best, "runs" if len(data) > 1 else "parts of the run")
    return ModelComparison(rows, best, f"{text} {decision(rows)}" if len(rows) == 2 else text)


def _folds(data: Sequence[Poses]) -> list[Fold]:
    """Divisions of the data, each of which leaves out runs, or a part of a single run."""
    if len(data) > 1:
        count = min(len(data), _FOLDS)
        return [
            Fold(
                tuple(poses for k, poses in enumerate(data) if k % count != fold),
                tuple(HeldOut(poses, np.ones(len(poses), np.bool_)) for poses in data[fold::count]),
            )
            for fold in range(count)
        ]
    if not data or data[0].has_tip.sum() < _FEWEST_TIPS:
        raise NoDataError(
            "models are compared by predicting runs left out: give at least two runs, or one with at least "
            f"{_FEWEST_TIPS} plateaus"
        )
    (poses,) = data
    part = np.minimum(np.arange(len(poses)) * _PARTS // len(poses), _PARTS - 1)
    return [Fold((_without(poses, part == k),), (HeldOut(poses, part == k),)) for k in range(_PARTS)]


def _without(poses: Poses, entries: NDArray[np.bool_]) -> Poses:
    """Poses without some entries; a motion keeps the pressures there, because what follows depends on them."""
    if poses.moving:
        orientation = None if poses.orientation is None else poses.orientation.without(entries)
        return replace(poses, tip_m=np.where(entries[:, None], np.nan, poses.tip_m), orientation=orientation)
    return poses.only(~entries)


def best_of(rows: Sequence[ComparisonRow]) -> ComparisonRow:
    """The row of the least held-out error; one that remembers must be better than all others by `_MEMORY_GAIN`."""
    best = min(rows, key=lambda row: row.error_m)
    forgetful = [row for row in rows if not row.candidate.start.arm.remembers]
    if not forgetful or not best.candidate.start.arm.remembers:
        return best
    plain = min(forgetful, key=lambda row: row.error_m)
    return plain if best.error_m > (1 - _MEMORY_GAIN) * plain.error_m else best


def compared(poses: Poses) -> Poses:
    """The part of a long run that is compared: the start of a motion, or evenly spaced poses."""
    count = len(poses)
    if poses.moving:
        chosen = np.arange(min(count, _MAX_FRAMES))
    else:
        chosen = np.unique(np.linspace(0, count - 1, min(count, _MAX_POSES)).round().astype(int))
    return poses if len(chosen) == count else poses.only(chosen)


def excursion(poses: Poses) -> Array:
    """Distance (K,) [m] of each tip from the tip at the least pressure and weight."""
    effort = np.abs(poses.pressure_pa).sum(axis=1) / PA_PER_BAR + poses.weight_kg
    rest = poses.tip_m[np.flatnonzero(poses.has_tip)[np.argmin(effort[poses.has_tip])]]
    out: Array = np.linalg.norm(poses.tip_m - rest, axis=1)
    return out


def fit_all(task: ComparisonFit) -> Array:
    """AIC, BIC, fitted numbers and damping (NaN: undecided) of a fit to all runs; then the value of each unknown."""
    fit = task.fit()
    damping = next((e.value for e in fit.estimates if e.name == DAMPING), None)
    facts = [fit.aic, fit.bic, float(fit.fitted), np.nan if damping is None else damping]
    return np.array(facts + [e.used for e in fit.estimates])


def prediction_errors(task: ComparisonFit) -> Array:
    """Prediction errors of the held-out tips: distances [m], and distances over the excursion of the run, (2, K)."""
    setup, found = task.fit().setup, []
    for held in task.held_out:
        poses = held.poses
        moved, seen = excursion(poses), poses.has_tip
        error = np.linalg.norm(poses.tip_m - Predictor(poses)(setup), axis=1)
        # Without a solution the prediction is the tip at rest.
        error = np.where(np.isfinite(error), error, moved)[seen & held.entries]
        found.append(np.stack([error, error / moved[seen].max()]))
    return np.concatenate(found, axis=1)


def _unknowns(task: ComparisonFit) -> list[tuple[str, str]]:
    """Name and run of each unknown, in the order of `fit_all`."""
    stated = None if task.stated is None else dict(task.stated)
    unknowns, _ = unknowns_for(task.data, task.candidate.start, task.candidate.free, {}, stated, ())
    return [(one.name, "" if one.run is None else task.data[one.run].run_id) for one in unknowns]


def _row(candidate: Candidate, found: Array, errors: Array) -> ComparisonRow:
    aic, bic, dof, damping = found[:_FACTS].tolist()
    return ComparisonRow(
        candidate=candidate,
        error_percent=float(100 * errors[1].mean()),
        error_m=float(np.sqrt((errors[0] ** 2).mean())),
        aic=aic,
        bic=bic,
        dof=int(dof),
        damping_s=None if np.isnan(damping) else damping,
    )


def decision(rows: Sequence[ComparisonRow]) -> str:
    """Which of two models the data prefer, by the lower BIC; the odds are exp of half the difference."""
    name = _named(rows)
    preferred, other = sorted(rows, key=lambda row: row.bic)
    gain = other.bic - preferred.bic
    if gain < MIN_DECISIVE:
        return f"The data do not decide between {name(preferred)} and {name(other)} (BIC {gain:.1f} apart)."
    power = gain / 2 / math.log(10)
    odds = f"about {10**power:.0f}" if power < 3 else "more than 1000"
    return f"Decision: {name(preferred)}; BIC lower by {gain:.1f}, odds of {odds} to 1 against {name(other)}."


def sentence(rows: Sequence[ComparisonRow], best: ComparisonRow, parts: str = "runs") -> str:
    """The conclusion of a comparison, with a warning if the BIC of the fits to all data prefers another model.

    parts: what was left out.
    """
    name = _named(rows)
    text = f"{name(best)} predicts {parts} left out best: {best.error_m * 1e3:.3g} mm rms"
    simpler = [r for r in rows if r.dof < best.dof]
    if simpler:
        rival = min(simpler, key=lambda row: row.error_m)
        gain = 100 * (1 - best.error_m / rival.error_m)
        worth = rival.bic - best.bic
        text += f", {gain:.0f} % less than {name(rival)} ({rival.error_m * 1e3:.3g} mm)"
        if worth > _MIN_BIC_GAIN:
            text += f"; the data pay for the larger model (BIC lower by {worth:.0f})"
        else:
            text += f"; but the data do not pay for it (BIC {'lower' if worth > 0 else 'higher'} by {abs(worth):.0f})"
    text += "."
    closest = min(rows, key=lambda row: row.error_m)
    if closest is not best and closest.candidate.start.arm.remembers:
        nearer = 100 * (1 - closest.error_m / best.error_m)
        text += (
            f" {name(closest)} predicts them {nearer:.0f} % better, but a memory must gain {100 * _MEMORY_GAIN:.0f} %."
        )
    fittest = min(rows, key=lambda row: row.bic)
    if (better := best.bic - fittest.bic) > _MIN_BIC_GAIN and fittest not in simpler:
        text += (
            f" {name(fittest)} fits all {parts} together better (BIC lower by {better:.0f}): the {parts} are too few, "
        )
        text += "or too different, for each to be predicted from the others."
    return text


def _named(rows: Sequence[ComparisonRow]) -> Callable[[ComparisonRow], str]:
    """Names of rows in the conclusion, with their damping if it differs."""
    differ = len({row.candidate.damping for row in rows}) > 1

    def name(row: ComparisonRow) -> str:
        damping = ("with damping" if row.candidate.damping else "without damping") if differ else ""
        return f"{row.candidate.name} {damping}".rstrip()

    return name
