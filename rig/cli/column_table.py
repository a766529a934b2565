"""A table that is readable on a narrow terminal, where it is a list of rows."""

from __future__ import annotations

from rich.console import Console, ConsoleOptions, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

LEAST_COLUMNS = 60
"""A narrower terminal has no room for columns side by side."""


class ColumnTable(Table):
    """A table without lines; below `LEAST_COLUMNS` each row is its first cell, then a line for each other cell."""

    def __init__(self) -> None:
        super().__init__(box=None, padding=(0, 2, 0, 0), title_justify="left")

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
            listed = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
            listed.add_column()
            listed.add_column(overflow="fold")
            for head, cell in filled:
                listed.add_row(head, cell)
            yield Padding(listed, (0, 0, 0, 2 if len(filled) > 1 else 0))
