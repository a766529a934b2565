"""Escape control characters and bidirectional marks in terminal output.

Titles, notes, archives and file names are untrusted. Control characters in them could change the terminal's colours,
move its cursor, or reverse a name. `rig.cli.app.main` puts a `PrintableStream` over the standard
streams; the console of every screen (`rig.cli.output.console`) bypasses it and escapes the characters itself.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast

from runs.printable_text import printable


class PrintableStream:
    """A text stream that escapes and forwards. Consoles bypass it through `rich_proxied_file`."""

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError(f"a text is written, not {type(text).__name__}")
        self.rich_proxied_file.write(printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def close(self) -> None:
        """Leave the underlying stream open."""

    def __getattr__(self, name: str) -> Any:
        """Everything else is that of the stream below, but for its bytes, which would be written as they are."""
        if name == "buffer":
            raise AttributeError(name)
        return getattr(self.rich_proxied_file, name)


@contextmanager
def printable_streams() -> Iterator[None]:
    """Replace standard output and standard error by a `PrintableStream` each."""
    out, err = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = wrapped = [cast(TextIO, PrintableStream(stream)) for stream in (out, err)]
    try:
        yield
    finally:
        # click replaces a stream whose pipe is closed; that replacement stays.
        sys.stdout = out if sys.stdout is wrapped[0] else sys.stdout
        sys.stderr = err if sys.stderr is wrapped[1] else sys.stderr
