"""Plans of the tip controller: how many were followed or refused and why, and what they took."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runs.archive.reader import ArchiveReader
from runs.columns import FOLLOWED_S, SolveStatus


class PlanCounts:
    """Number of plans by `SolveStatus`."""

    def __init__(self, statuses: ArrayLike = ()) -> None:
        self._counts: NDArray[np.int64] = np.zeros(len(SolveStatus), dtype=np.int64)
        self.add(statuses)

    def add(self, statuses: ArrayLike) -> None:
        """Count plans with these statuses."""
        self._counts += np.bincount(np.asarray(statuses, dtype=np.int64).ravel(), minlength=len(SolveStatus))

    def __getitem__(self, status: SolveStatus) -> int:
        return int(self._counts[status])

    @property
    def total(self) -> int:
        """All plans."""
        return int(self._counts.sum())

    @property
    def refused(self) -> dict[str, int]:
        """Number of refused plans by reason."""
        return {status.words: self[status] for status in SolveStatus if status.refused and self[status]}

    @property
    def at_fault(self) -> bool:
        """True if plans were refused because the controller made them wrong."""
        return any(status.at_fault and self[status] for status in SolveStatus)


def refusals(refused: dict[str, int]) -> str:
    """The reasons of refused plans in a message."""
    return ", ".join(f"{count} {reason}" for reason, count in refused.items())


NAN = float("nan")


@dataclass(frozen=True)
class TipPlans:
    """The plans of a run: how many, and the time of the step that made one [ms]; NaN in virtual time."""

    count: int
    not_solved: int
    """The solver found none; the one before was continued."""
    refused: dict[str, int]
    """Number of those that the control loop refused, by reason."""
    constrained: int
    """With at least one active constraint."""
    without_feedback: float
    """Share of the tip paths, with their lead-in, on which no plan had begun for FOLLOWED_S."""
    solve_p50_ms: float = NAN
    solve_p99_ms: float = NAN
    solve_max_ms: float = NAN


def tip_plans(run: ArchiveReader) -> TipPlans | None:
    """Return what the plans of a run took; None for a run without any."""
    plans = run.tip_control
    if plans is None or not len(plans.time_s):
        return None
    counted = PlanCounts(plans.status)
    counts = (counted.total, counted[SolveStatus.NOT_SOLVED], counted.refused, int((plans.active > 0).sum()))
    solve_ms = plans.solve_us * 1e-3
    unfed = _without_feedback(run)
    if not solve_ms.any():
        return TipPlans(*counts, unfed)
    return TipPlans(*counts, unfed, *(float(np.percentile(solve_ms, share)) for share in (50, 99, 100)))


def _without_feedback(run: ArchiveReader) -> float:
    """The share of the frames on tip paths that were without feedback; NaN without a frame on a path."""
    assert run.tip_control is not None
    if run.reference is None or not (on_path := run.reference.motion > 0).any():
        return NAN
    motion, times_s = run.reference.motion[on_path], run.tip.protocol_s[on_path]
    # Before its first plan a motion is without one since it began.
    begun_s = times_s[np.searchsorted(motion, motion)]
    followed = run.tip_control.status < SolveStatus.REFUSED
    starts_s = np.concatenate([[-np.inf], run.tip_control.start_s[followed]])
    newest_s = starts_s[np.searchsorted(starts_s, times_s, side="right") - 1]
    return float(np.mean(times_s - np.maximum(begun_s, newest_s) > FOLLOWED_S))
