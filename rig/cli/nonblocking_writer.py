"""A non-blocking text stream: output that a blocked terminal does not accept is dropped."""

from __future__ import annotations

import os
import threading
from collections import deque
from typing import TextIO

MOST_BYTES = 1 << 18
CLOSE_TIMEOUT_S = 1.0


class NonBlockingWriter:
    """Buffers a stream. A thread of its own writes, so only it blocks on Ctrl-S, a full pipe or a hung terminal."""

    def __init__(self, stream: TextIO) -> None:
        """Write to the file of `stream` until `close`."""
        stream.flush()
        self.encoding = stream.encoding
        self._stream = stream
        self._fd = stream.fileno()
        self._queue: deque[bytes] = deque()
        self._bytes = 0
        self._ready = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._write_queue, name="writer", daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Queue a text without blocking."""
        data = text.encode(self.encoding, "replace")
        with self._ready:
            if self._open and self._bytes + len(data) <= MOST_BYTES:
                self._queue.append(data)
                self._bytes += len(data)
                self._ready.notify()
        return len(text)

    def flush(self) -> None:
        """Do nothing: the thread writes at once."""

    def isatty(self) -> bool:
        """Delegate to the underlying stream."""
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        """Wait up to `CLOSE_TIMEOUT_S` for queued output, then stop."""
        with self._ready:
            self._open = False
            self._ready.notify()
        self._thread.join(CLOSE_TIMEOUT_S)

    def _write_queue(self) -> None:
        while True:
            with self._ready:
                while not self._queue and self._open:
                    self._ready.wait()
                if not self._queue:
                    return
                data = self._queue.popleft()
            try:
                while data:
                    data = data[os.write(self._fd, data) :]
            except OSError:
                # The terminal was closed: discard the remaining output.
                with self._ready:
                    self._open = False
                    self._queue.clear()
                return
            with self._ready:
                self._bytes = sum(map(len, self._queue))
