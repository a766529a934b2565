"""Output of every command: the console, tables and JSON.

The console prints control characters visibly, obeys no markup, and keeps numbers whole.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import typer
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from runs.printable_text import printable


def _parts(line: Text, width: int) -> list[Text]:
    """The line in parts of at most `width` columns that end between words; a longer word is a part of its own."""
    ends, start = [], 0
    for word in re.finditer(r"\S+", line.plain):
        if line.plain[start : word.start()].strip() and cell_len(line.plain[start : word.end()]) > width:
            start = word.start()
            ends.append(start)
    parts = list(line.divide(ends))
    for part in parts[:-1]:
        part.rstrip()
    return parts


class PrintableConsole(Console):
    """A console that escapes control characters and bidirectional marks, and interprets no markup or emoji codes.

    What is printed with `soft_wrap` is one line in a file; a terminal, which would break it anywhere, gets lines that
    end between words. In a file no line is cut off.
    """

    def __init__(self, stderr: bool = False, width: int | None = None) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, stderr=stderr, width=width)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print; words longer than a terminal's line, as paths, stay whole."""
        if options.get("soft_wrap") and self.is_terminal:
            objects = tuple(self._wrapped(one) for one in objects)
        super().print(*objects, **{"crop": self.is_terminal, **options})

    def _wrapped(self, given: Any) -> Any:
        """A text of lines that fit the terminal; anything else as it is."""
        if not isinstance(given, str | Text) or (isinstance(given, Text) and given.no_wrap):
            return given
        text = self.render_str(given) if isinstance(given, str) else given.copy()
        lines = [part for line in text.split("\n", allow_blank=True) for part in _parts(line, self.width)]
        return Text("\n").join(lines)

    def render_str(self, text: str, **options: Any) -> Text:
        """Escape a string before the layout, so that column widths match the output."""
        return super().render_str(printable(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Render anything; control codes of the console itself stay."""
        for part in super().render(renderable, options):
            yield part if part.control else part._replace(text=printable(part.text))


def console(stderr: bool = False) -> Console:
    """Return the console of every screen; output to a file is 110 columns wide."""
    plain = PrintableConsole(stderr)
    return plain if plain.is_terminal else PrintableConsole(stderr, 110)


LEAST_COLUMNS = 60
"""A narrower terminal has no room for columns side by side."""


_GAP = 2
"""Columns between two cells."""


class ColumnTable(Table):
    """A table without lines, in which no word is broken: a run id can be copied and searched for.

    Where the words need more room than a terminal has, each row is its first cell, then a line for each other cell. In
    a file the table is as wide as its words need.
    """

    def __init__(self, *heads: str, numbers: Iterable[str] = (), title: str | None = None) -> None:
        """Text columns with the `heads`, then columns of `numbers`; others are added with `add_column`."""
        super().__init__(box=None, padding=(0, _GAP, 0, 0), title=title, title_justify="left")
        for head in heads:
            self.add_column(head, overflow="fold")
        for head in numbers:
            self.add_column(head, justify="right")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        texts = [[str(text) for text in (column.header, *column.cells)] for column in self.columns]
        least = [max(cell_len(word) for text in column for word in (*text.split(), "")) for column in texts]
        needed = sum(least) + _GAP * len(least)
        fits = options.max_width >= needed or not console.is_terminal
        if fits and options.max_width >= LEAST_COLUMNS:
            room = max(options.max_width, needed)
            most = [max(cell_len(line) for text in column for line in (*text.split("\n"), "")) for column in texts]
            for column, width in zip(self.columns, _widths(least, most, room - _GAP * len(least)), strict=True):
                column.width = width
            yield from super().__rich_console__(console, options.update(max_width=room))
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


def _widths(least: Sequence[int], most: Sequence[int], room: int) -> list[int]:
    """The widths of columns that need `least` and would fill `most`; those that lack room share what is left."""
    spare, wanted = room - sum(least), sum(most) - sum(least)
    share = 1.0 if wanted <= spare else spare / wanted
    return [low + int((high - low) * share) for low, high in zip(least, most, strict=True)]


def facts_table(facts: Iterable[tuple[RenderableType, RenderableType]] = ()) -> Table:
    """Return a table without heads: a name and its value in each row."""
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column()
    table.add_column(overflow="fold")
    for name, value in facts:
        table.add_row(name, value)
    return table


def print_json(facts: Any) -> None:
    """Print indented JSON; a dataclass becomes an object, NaN and infinity become null."""
    from pydantic_core import to_jsonable_python

    typer.echo(json.dumps(to_jsonable_python(facts, inf_nan_mode="null"), indent=2))
