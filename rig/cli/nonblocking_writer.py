"""A text stream that never keeps its writer waiting: what a blocked terminal does not take is dropped."""

from __future__ import annotations

import os
import threading
from collections import deque
from typing import TextIO

MOST_BYTES = 1 << 18
LAST_WORDS_S = 1.0


class NonBlockingWriter:
    """Stands before a stream. A thread of its own waits for the reader (Ctrl-S, a full pipe, a terminal that hangs)."""

    def __init__(self, stream: TextIO) -> None:
        """Write to what is behind `stream` from now on, until `close`."""
        stream.flush()
        self.encoding = stream.encoding
        self._stream = stream
        self._fd = stream.fileno()
        self._waiting: deque[bytes] = deque()
        self._bytes = 0
        self._some = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._pour, name="outlet", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Take a text; never waits."""
        data = text.encode(self.encoding, "replace")
        with self._some:
            if self._open and self._bytes + len(data) <= MOST_BYTES:
                self._waiting.append(data)
                self._bytes += len(data)
                self._some.notify()
        return len(text)

    def flush(self) -> None:
        """Nothing is held back, and nothing is waited for."""

    def isatty(self) -> bool:
        """As the stream behind it."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """As the stream behind it."""
        return self._fd

    def close(self) -> None:
        """Wait a moment for what is still to be written, then give up."""
        with self._some:
            self._open = False
            self._some.notify()
        self._thread.join(LAST_WORDS_S)

    def _pour(self) -> None:
        while True:
            with self._some:
                while not self._waiting and self._open:
                    self._some.wait()
                if not self._waiting:
                    return
                data = self._waiting.popleft()
            try:
                while data:
                    data = data[os.write(self._fd, data) :]
            except OSError:
                # The terminal has gone: nobody will ever read this, or anything after it.
                with self._some:
                    self._open = False
                    self._waiting.clear()
                return
            with self._some:
                self._bytes = sum(map(len, self._waiting))
