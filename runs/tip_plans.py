"""What the tip controller needed for its plans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from runs.archive.reader import ArchiveReader
from runs.plan_counts import PlanCounts
from runs.records import SolveStatus

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
    solve_p50_ms: float = NAN
    solve_p99_ms: float = NAN
    solve_max_ms: float = NAN


def tip_plans(run: ArchiveReader) -> TipPlans | None:
    """Return the plans of a run; None for a run without any."""
    plans = run.tip_control
    if plans is None or not len(plans.time_s):
        return None
    counted = PlanCounts(plans.status)
    counts = (counted.total, counted[SolveStatus.NOT_SOLVED], counted.refused, int((plans.active > 0).sum()))
    solve_ms = plans.solve_us * 1e-3
    if not solve_ms.any():
        return TipPlans(*counts)
    return TipPlans(*counts, *(float(np.percentile(solve_ms, share)) for share in (50, 99, 100)))
