"""The console of every screen: it prints control characters visibly and obeys no markup."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from runs.printable_text import printable


class PrintableConsole(Console):
    """A console that escapes control characters and bidirectional marks, and interprets no markup or emoji codes."""

    def __init__(self, stderr: bool = False, width: int | None = None) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, stderr=stderr, width=width)

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
