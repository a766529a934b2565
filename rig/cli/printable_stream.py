"""Escape control characters and bidirectional marks in terminal output.

Titles, notes, archives and file names are untrusted. Control characters in them could change the terminal's colours,
move its cursor, or reverse a name. `rig.cli.app.main` puts a `PrintableStream` over the standard
streams; the console of every screen (`rig.cli.output.console`) bypasses it and escapes the characters itself.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from runs.printable_text import printable


class PrintableStream(io.TextIOBase):
    """A text stream that escapes and forwards. Consoles bypass it through `rich_proxied_file`."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError(f"a text is written, not {type(text).__name__}")
        self.rich_proxied_file.write(printable(text))
        return len(text)

    def flush(self) -> None:
        self.rich_proxied_file.flush()

    def close(self) -> None:
        """Leave the underlying stream open."""

    def isatty(self) -> bool:
        """Tell whether the stream below is a terminal."""
        return self.rich_proxied_file.isatty()

    def fileno(self) -> int:
        return self.rich_proxied_file.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Delegate to the underlying stream."""
        return self.rich_proxied_file.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        """Delegate to the underlying stream."""
        return self.rich_proxied_file.errors


@contextmanager
def printable_streams() -> Iterator[None]:
    """Replace standard output and standard error by a `PrintableStream` each."""
    out, err = sys.stdout, sys.stderr
    wrapped = PrintableStream(out), PrintableStream(err)
    sys.stdout, sys.stderr = wrapped
    try:
        yield
    finally:
        # click replaces a stream whose pipe is closed; that replacement stays.
        sys.stdout = out if sys.stdout is wrapped[0] else sys.stdout
        sys.stderr = err if sys.stderr is wrapped[1] else sys.stderr
