"""Escape control characters and bidirectional marks in terminal output.

Titles, notes, archives and file names are untrusted. Control characters in them could change the terminal's colours,
move its cursor, or reverse a name. `rig.cli.app.main` puts a `PrintableStream` over the standard
streams; the console of every screen (`rig.cli.console.console`) bypasses it and escapes the characters itself.
"""

from __future__ import annotations

import io
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

_KEPT = "\n\t\u200c\u200d"
"""Newline, tab, and the joiners of Persian, Hindi and emoji."""


def printable(text: str) -> str:
    """Return a text with every control character and mark of direction as its escape: ESC as `\\x1b`."""
    if text.isprintable():
        return text
    return "".join(map(_shown, text))


def _shown(sign: str) -> str:
    # str.isprintable accepts no space but U+0020.
    if sign.isprintable() or sign in _KEPT or unicodedata.category(sign) == "Zs":
        return sign
    if "\udc80" <= sign <= "\udcff":
        return f"\\x{ord(sign) - 0xDC00:02x}"  # a byte of a file name that is not UTF-8
    return sign.encode("unicode_escape", "surrogatepass").decode("ascii")


class PrintableStream(io.TextIOBase):
    """A text stream that escapes and forwards. Consoles bypass it through `rich_proxied_file`."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Write a text with its control characters escaped."""
        if not isinstance(text, str):
            raise TypeError(f"a text is written, not {type(text).__name__}")
        self.rich_proxied_file.write(printable(text))
        return len(text)

    def flush(self) -> None:
        """Flush the stream below."""
        self.rich_proxied_file.flush()

    def close(self) -> None:
        """Leave the underlying stream open."""

    def isatty(self) -> bool:
        """Tell whether the stream below is a terminal."""
        return self.rich_proxied_file.isatty()

    def fileno(self) -> int:
        """Return the file of the stream below."""
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
