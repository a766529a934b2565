"""How many plans of the tip controller were followed or refused, and why."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runs.columns import SolveStatus


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
