"""Comparison of a result with the paper's: printed value, computed value, reason of the difference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ResultOrigin = Literal["text", "model", "simulated", "measured"]
"""Where a result comes from: the printed numbers alone, the model with them, a simulated rig, or a real one."""


@dataclass(frozen=True)
class PaperComparison:
    """One line of the comparison: the value that the paper prints, and the computed one.

    `paper` is empty where the paper shows a curve without numbers.
    """

    item: str
    what: str
    paper: str
    computed: str
    origin: ResultOrigin
    why: str
