"""What the rows of a run add up to, computed once: for the console, the page and the footer of the archive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from runs.columns.observations import model_error_mm
from runs.tip_plans import PlanCounts


class RunTotals:
    """The newest row of each kind, the gaps in the rows, and the mean error of the model; rows come in order."""

    def __init__(self) -> None:
        self.sample: NDArray[np.void] | None = None
        self.observation: NDArray[np.void] | None = None
        self.adaptation: NDArray[np.void] | None = None
        self.plans = PlanCounts()
        self.missed = 0
        """Deadlines of control that were missed."""
        self.dropped = 0
        """Camera frames without a row."""
        self._error_sum_mm, self._errors = 0.0, 0

    def add_samples(self, rows: NDArray[np.void]) -> None:
        """Add rows of `samples`, at least one."""
        self.sample = rows[-1]
        self.missed += int(rows["missed"].sum())

    def add_observations(self, rows: NDArray[np.void]) -> tuple[Array, Array]:
        """Add rows (n,) of `observations`, at least one; return the model's error (n,) and its mean so far [mm].

        The error is NaN where no tip was measured; the mean counts the others, and is NaN before the first.
        """
        self.observation = rows[-1]
        self.dropped += int(rows["dropped"].sum())
        error = model_error_mm(rows)
        known = np.isfinite(error)
        total = self._error_sum_mm + np.cumsum(np.where(known, error, 0.0))
        count = self._errors + np.cumsum(known)
        self._error_sum_mm, self._errors = float(total[-1]), int(count[-1])
        return error, np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def add_adaptations(self, rows: NDArray[np.void]) -> None:
        """Add rows of `adaptations`, at least one."""
        self.adaptation = rows[-1]
