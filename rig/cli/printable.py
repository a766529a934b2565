"""What goes to a terminal: control characters and marks of direction are shown, never obeyed.

Titles, notes, archives and file names come from anywhere. Control characters in them could change the terminal's
colours, move its cursor, or show a name backwards. `rig.cli.app.main` puts a `PrintableStream` over the standard
streams; the console of every screen (`rig.cli.run_output.console`) bypasses it and escapes the characters itself.
"""

from __future__ import annotations

import io
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

_KEPT = "\n\t\u200c\u200d"
"""Lines, columns, and the joiners that Persian, Hindi and emoji are written with."""


def printable(text: str) -> str:
    """Return a text with every control character and mark of direction as its escape: ESC as `\\x1b`."""
    if text.isprintable():
        return text
    return "".join(map(_shown, text))


def _shown(sign: str) -> str:
    # The spaces of languages are not printable to Python, which means the plain one only.
    if sign.isprintable() or sign in _KEPT or unicodedata.category(sign) == "Zs":
        return sign
    if "\udc80" <= sign <= "\udcff":
        return f"\\x{ord(sign) - 0xDC00:02x}"  # a byte of a file name that is no UTF-8
    return sign.encode("unicode_escape", "surrogatepass").decode("ascii")


class PrintableStream(io.TextIOBase):
    """A stream of text over another. Consoles write to the other, which `rich_proxied_file` tells them."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Write a text, printable."""
        if not isinstance(text, str):
            raise TypeError(f"a text is written, not {type(text).__name__}")
        self.rich_proxied_file.write(printable(text))
        return len(text)

    def flush(self) -> None:
        """Flush the stream below."""
        self.rich_proxied_file.flush()

    def close(self) -> None:
        """Leave the stream below open: it is not this one's."""

    def isatty(self) -> bool:
        """Tell whether the stream below is a terminal."""
        return self.rich_proxied_file.isatty()

    def fileno(self) -> int:
        """Return the file of the stream below."""
        return self.rich_proxied_file.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Of the stream below."""
        return self.rich_proxied_file.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        """Of the stream below."""
        return self.rich_proxied_file.errors


@contextmanager
def printable_streams() -> Iterator[None]:
    """Lay a `PrintableStream` over standard output and standard error."""
    out, err = sys.stdout, sys.stderr
    over = PrintableStream(out), PrintableStream(err)
    sys.stdout, sys.stderr = over
    try:
        yield
    finally:
        # A stream whose reader has gone was replaced by the command-line library, and stays so.
        sys.stdout = out if sys.stdout is over[0] else sys.stdout
        sys.stderr = err if sys.stderr is over[1] else sys.stderr
