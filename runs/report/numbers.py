"""Numbers as the report writes them."""

from __future__ import annotations

import math
from collections.abc import Sequence

DASH = "–"
MOST_LISTED = 12
"""Numbers that a list shows."""


def plain(value: float, digits: int) -> str:
    """Return a number with a real minus, none before zero, and a dash for what is not known."""
    if math.isinf(value):
        return "never"
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}") if math.isfinite(value) else DASH


def significant(value: float, digits: int) -> str:
    """Return a number with so many significant digits, and a dash for what is not known."""
    return f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}") if math.isfinite(value) else DASH


def with_unit(value: float, unit: str, digits: int) -> str:
    """Return a number and its unit."""
    return f"{plain(value, digits)} <small>{unit}</small>" if not math.isinf(value) else "never"


def listed(values: Sequence[float], digits: int) -> str:
    """Return the first numbers of a list."""
    return ", ".join(plain(value, digits) for value in values[:MOST_LISTED]) + (
        " .." if len(values) > MOST_LISTED else ""
    )


def three(values: tuple[float, float, float], digits: int) -> str:
    """Return a vector, one dash where it is not known."""
    return "&ensp;".join(plain(value, digits) for value in values) if math.isfinite(values[0]) else DASH
