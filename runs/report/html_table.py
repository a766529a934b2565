"""Tables of the report as HTML, and the numbers in them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]], words: int | None = None, kind: str = "") -> str:
    """Return a table that scrolls where the page is narrow; empty without rows. Heads and cells are HTML.

    The first `words` columns are text (by default all), the others numbers; `kind` is the class of the table.
    """
    numbers = len(heads) if words is None else words

    def row(cells: Sequence[str], tag: str) -> str:
        marked = (f"<{tag}{' class=n' if k >= numbers else ''}>{cell}</{tag}>" for k, cell in enumerate(cells))
        return f"<tr>{''.join(marked)}</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    style = f' class="{kind}"' if kind else ""
    return f'<div class="scroll"><table{style}>{row(heads, "th")}{body}</table></div>' if body else ""


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
