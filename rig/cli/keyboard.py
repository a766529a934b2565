"""Single keys from the terminal, without waiting for Enter and without stopping the program in the background."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from typing import Any


class Keyboard:
    """Context manager for single keys; without a terminal, standard input is read as it arrives.

    Only the foreground process may touch the terminal: a program in the background that tries is stopped by the
    kernel, and a stopped run is an aborted one.
    """

    def __init__(self) -> None:
        self.ended = False
        """True once standard input has ended."""
        self._before: list[Any] | None = None

    def __enter__(self) -> Keyboard:
        if self._foreground():
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin, termios.TCSANOW)
        return self

    def __exit__(self, *error: object) -> None:
        if self._before is not None and self._foreground():
            termios.tcsetattr(sys.stdin, termios.TCSANOW, self._before)

    def pressed(self) -> str:
        """Return the characters since the last call."""
        if self.ended or not self._readable():
            return ""
        try:
            data = os.read(sys.stdin.fileno(), 256)
        except OSError:  # the terminal was closed
            data = b""
        self.ended = not data
        return data.decode(errors="replace")

    def _readable(self) -> bool:
        try:
            return (not os.isatty(sys.stdin.fileno()) or self._foreground()) and bool(
                select.select([sys.stdin], [], [], 0)[0]
            )
        except (OSError, ValueError):
            return False

    def _foreground(self) -> bool:
        try:
            return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
        except (OSError, ValueError):
            return False
