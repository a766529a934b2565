"""Comparison of a result with the paper's: printed value, computed value, reason of the difference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

Origin = Literal["text", "model", "simulated", "measured"]
"""By the printed numbers alone; by the model with them; by a simulated rig; by a real one."""


@dataclass(frozen=True)
class PaperComparison:
    """One line of the comparison; `paper` is empty where the paper shows a curve without numbers."""

    item: str
    what: str
    paper: str
    here: str
    origin: Origin
    why: str


@dataclass(frozen=True)
class PaperFigure:
    """One figure: `draw(figure, *about)` at a size in inches."""

    name: str
    title: str
    draw: Callable[..., None]
    size: tuple[float, float]
    caption: str
    about: tuple[object, ...] = field(default=())
