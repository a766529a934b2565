"""A non-blocking text stream: output that a blocked terminal does not accept is dropped."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from queue import Full, Queue
from typing import TextIO

MOST_TEXTS = 1024
"""Texts that wait at most; one is a line, or a whole screen."""
CLOSE_TIMEOUT_S = 1.0


class NonBlockingWriter:
    """Queues a stream. A thread of its own writes, so only it blocks on Ctrl-S, a full pipe or a hung terminal."""

    def __init__(self, stream: TextIO) -> None:
        """Write to the file of `stream` until `close`; raises OSError for a stream without one."""
        stream.flush()
        self.encoding = stream.encoding
        self._stream = stream
        self._fd = stream.fileno()
        self._queue: Queue[bytes | None] = Queue(MOST_TEXTS)
        self._thread = threading.Thread(target=self._write_queue, name="writer", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Queue a text without blocking."""
        with suppress(Full):
            self._queue.put_nowait(text.encode(self.encoding, "replace"))
        return len(text)

    def flush(self) -> None:
        """Do nothing: the thread writes at once."""

    def isatty(self) -> bool:
        """Delegate to the underlying stream."""
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        """Wait up to twice `CLOSE_TIMEOUT_S` for queued output, then stop."""
        with suppress(Full):
            self._queue.put(None, timeout=CLOSE_TIMEOUT_S)
        self._thread.join(CLOSE_TIMEOUT_S)

    def _write_queue(self) -> None:
        with suppress(OSError):  # the terminal was closed: discard the remaining output
            while (data := self._queue.get()) is not None:
                while data:
                    data = data[os.write(self._fd, data) :]
