"""Log of the page's process. It shares the terminal of the run, which no client of the page can fill."""

from __future__ import annotations

import logging
import sys


class PageLog(logging.Handler):
    """Prints a warning or error as one line without a traceback, and only the first from each source line."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._seen: set[tuple[str, int]] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record unless one from the same source line has been printed."""
        source = record.pathname, record.lineno
        if source in self._seen:
            return
        self._seen.add(source)
        lines = record.getMessage().strip().splitlines() or [""]
        # uvicorn logs a failed start as the text of a traceback, which ends with the reason.
        message = lines[-1] if lines[0].startswith("Traceback") else lines[0]
        if record.exc_info and record.exc_info[1]:
            error = record.exc_info[1]
            message += f" ({type(error).__name__}: {error})"
        print("live page:", "".join(c for c in message if c.isprintable()), file=sys.stderr, flush=True)
