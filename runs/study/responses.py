"""What a study measures of each run: one number per run, from its summary and its tip."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from runs.run import Run


@dataclass(frozen=True)
class ResponseVariable:
    """A number of a run."""

    name: str
    unit: str
    about: str
    of: Callable[[Run], float]

    @property
    def title(self) -> str:
        """Name at the head of a section."""
        return self.name.replace("_", " ").capitalize()


def _travel_mm(run: Run) -> float:
    tip = run.tip.measured_mm
    known = tip[np.isfinite(tip).all(axis=1)]
    return float(np.linalg.norm(known - known[0], axis=1).max()) if len(known) else math.nan


RESPONSES = (
    ResponseVariable("tip_travel", "mm", "largest distance of the measured tip from its first position", _travel_mm),
    ResponseVariable(
        "mean_error", "mm", "mean distance of measured and modelled tip", lambda run: run.summary.error_mm.mean
    ),
    ResponseVariable(
        "largest_error", "mm", "largest distance of measured and modelled tip", lambda run: run.summary.error_mm.max
    ),
    ResponseVariable(
        "settled_error",
        "mm",
        "mean distance of measured and modelled tip over the dwells",
        lambda run: run.summary.settled_error_mm,
    ),
    ResponseVariable("tracking", "bar", "rms of measured minus set-point", lambda run: run.summary.tracking_rms_bar),
)
