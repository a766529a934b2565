"""Tables of the report as HTML."""

from __future__ import annotations

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
