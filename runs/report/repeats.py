"""Which of several runs are repeats of each other, how far their measured tips scatter, and what is not counted."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from runs.arrays import Array
from runs.records import DetectionStatus, Status
from runs.report.differences import played_steps, tips_at_equal_times
from runs.report.html import DASH, folded, html_table, plain, small
from runs.report.overlay import named
from runs.report.settings import conditions, unequal
from runs.run import Run

_MOST_NAMED = 3
"""Differing settings that a reason names."""
_DEFINITION = (
    "Repeats are finished runs that share protocol and its parameters, rig file, calibrations, identified parameters, "
    "model, tip controller, executor and specimen. Seed, operator, notes, other metadata and versions may differ."
)


@dataclass(frozen=True)
class _Candidate:
    """A run, and what its repeats share with it: settings by name, and the steps as they were played."""

    run: Run
    settings: dict[str, str]
    steps: tuple[tuple[object, ...], ...]

    @classmethod
    def of(cls, run: Run) -> _Candidate:
        return cls(run, conditions(run), played_steps(run))

    def repeats(self, other: _Candidate) -> bool:
        return self.settings == other.settings and self.steps == other.steps


@dataclass(frozen=True)
class NotCounted:
    """A run that is no repeat of any other, and why."""

    run_id: str
    reason: str


@dataclass(frozen=True)
class RepeatGroup:
    """Two or more runs that are repeats of each other; `apart` says what sets them apart from the first group."""

    runs: tuple[Run, ...]
    apart: str

    @property
    def scatter_mm(self) -> float:
        """Standard deviation of the measured tips about their mean."""
        return repeatability_mm(tips_at_equal_times(self.runs)[1])


def repeat_groups(runs: Sequence[Run]) -> tuple[tuple[RepeatGroup, ...], tuple[NotCounted, ...]]:
    """Return the groups of repeats among runs, and every other run with the reason why it is not counted."""
    groups: list[list[_Candidate]] = []
    left_out: list[NotCounted] = []
    parents = {run.header.run_id: run.header.parent for run in runs}
    for one in map(_Candidate.of, runs):
        own = next((group for group in groups if group[0].repeats(one)), [])
        if reason := _unusable(one.run) or _no_new_measurement(one.run, [other.run for other in own], parents):
            left_out.append(NotCounted(one.run.header.run_id, reason))
            continue
        if not own:
            groups.append(own)
        own.append(one)
    counted = [group for group in groups if len(group) > 1]
    references = [group[0] for group in counted or groups[:1]]
    single = (group[0] for group in groups if len(group) == 1)
    left_out += [
        NotCounted(one.run.header.run_id, _nearest(one, references)) for one in single if one not in references
    ]
    found = tuple(
        RepeatGroup(tuple(one.run for one in group), _apart(group[0], counted[0][0]) if k else "")
        for k, group in enumerate(counted)
    )
    return found, tuple(left_out)


def _unusable(run: Run) -> str:
    if run.status is not Status.FINISHED:
        return f"it did not finish ({run.status})"
    return "" if (run.tip.seen == DetectionStatus.MEASURED).sum() > 1 else "no tip was measured"


def _no_new_measurement(run: Run, others: Sequence[Run], parents: dict[str, str]) -> str:
    """Return why a run has the measurements of one of these others; empty if it has its own."""
    header = run.header
    for other in others:
        if _recording(run, parents) == _recording(other, parents):
            return f"it has the measurements of {other.header.run_id}"
        if header.executor == "virtual time" and header.seed == other.header.seed:
            return (
                f"it is simulated with the seed of {other.header.run_id} ({header.seed}), so with equal random numbers"
            )
    return ""


def _recording(run: Run, parents: dict[str, str]) -> str:
    """Return the id of the run that measured: of a replay that which it replays, as far as it is among the runs."""
    run_id = run.header.run_id
    seen = set[str]()
    while run_id not in seen and (parent := parents.get(run_id, "")):
        seen.add(run_id)
        run_id = parent
    return run_id


def _nearest(run: _Candidate, references: Sequence[_Candidate]) -> str:
    """Return what sets a run apart from that of the others with which it shares most."""
    other = min(references, key=lambda other: len(unequal([run.settings, other.settings])))
    return f"{_apart(run, other)} (compared with {other.run.header.run_id})"


def _apart(run: _Candidate, other: _Candidate) -> str:
    rows = unequal([run.settings, other.settings])
    if not rows:
        return "its steps were played at other times"
    named = [f"{name}: {own or DASH} instead of {theirs or DASH}" for name, (own, theirs) in rows.items()]
    more = len(named) - _MOST_NAMED
    return "; ".join(named[:_MOST_NAMED]) + (f"; {more} more in the table of settings" if more > 0 else "")


def repeatability_mm(tips_mm: Array) -> float:
    """Return the standard deviation of repeated tips (runs, n, 3) about their mean, pooled over time; 3-D."""
    variance = tips_mm.var(axis=0, ddof=1).sum(axis=1) if len(tips_mm) > 1 else np.empty(0)
    known = variance[np.isfinite(variance)]
    return float(np.sqrt(known.mean())) if len(known) else math.nan


def section(runs: Sequence[Run]) -> str:
    """Return the part of a comparison on the repeatability of its runs, with what is not counted and why."""
    groups, left_out = repeat_groups(runs)
    heads = ("repeats", "runs", "scatter of the tip<br>[mm]", "apart from the first group by")
    shown = len(heads) if len(groups) > 1 else len(heads) - 1
    rows = [row[:shown] for row in _rows(groups)]
    about = "3-D standard deviation of the measured tips about their mean at equal protocol times."
    parts = (
        "<h2>Repeatability</h2>",
        html_table(heads[:shown], rows, words=1) + small(about) if groups else "<p>No run repeats another.</p>",
        folded("Runs that are not counted", _list(left_out) + small(_DEFINITION)),
    )
    return "\n".join(parts)


def _rows(groups: Sequence[RepeatGroup]) -> Iterator[tuple[str, ...]]:
    for group in groups:
        names = ", ".join(escape(named(run)) for run in group.runs)
        yield names, str(len(group.runs)), plain(group.scatter_mm, 3), escape(group.apart)


def _list(left_out: Sequence[NotCounted]) -> str:
    items = "".join(f"<li>{escape(one.run_id)}: {escape(one.reason)}</li>" for one in left_out)
    return f"<ul>{items}</ul>\n" if items else "<p>Every run is counted.</p>\n"
