"""Tables without lines: columns that become rows on a narrow terminal, and facts by name."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

LEAST_COLUMNS = 60
"""A narrower terminal has no room for columns side by side."""


class ColumnTable(Table):
    """A table without lines; below `LEAST_COLUMNS` each row is its first cell, then a line for each other cell."""

    def __init__(self, *heads: str, numbers: Iterable[str] = (), title: str | None = None) -> None:
        """Text columns with the `heads`, then columns of `numbers`; others are added with `add_column`."""
        super().__init__(box=None, padding=(0, 2, 0, 0), title=title, title_justify="left")
        for head in heads:
            self.add_column(head, overflow="fold")
        for head in numbers:
            self.add_column(head, justify="right")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render columns or, on a narrow terminal, rows."""
        if options.max_width >= LEAST_COLUMNS:
            yield from super().__rich_console__(console, options)
            return
        heads = [column.header for column in self.columns]
        for cells in zip(*(column.cells for column in self.columns), strict=True):
            first, *others = cells
            filled = [(head, cell) for head, cell in zip(heads[1:], others, strict=True) if str(cell)]
            if len(filled) == 1:
                filled = [(first, filled[0][1])]
            else:
                yield Text(f"{heads[0]} {first}".strip(), "bold")
            listed = facts_table(filled)
            yield Padding(listed, (0, 0, 0, 2 if len(filled) > 1 else 0))


def facts_table(facts: Iterable[tuple[RenderableType, RenderableType]] = ()) -> Table:
    """Return a table without heads: a name and its value in each row."""
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column()
    table.add_column(overflow="fold")
    for name, value in facts:
        table.add_row(name, value)
    return table
