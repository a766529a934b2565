"""Lock-free ring buffer of structured rows in shared memory, with one writer and any number of readers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COUNT_BYTES = 64  # one cache line, so that the count does not share one with the rows


def ring_bytes(dtype: np.dtype[np.void], capacity: int) -> int:
    """Size of a ring in bytes, rounded up to a cache line."""
    return COUNT_BYTES + -(-dtype.itemsize * capacity // 64) * 64


class RingBuffer:
    """A view of a ring buffer. The count of written rows is published after the row itself.

    Each reader keeps its own cursor; rows that were overwritten before they were read are counted as lost.
    """

    def __init__(self, buffer: memoryview, dtype: np.dtype[np.void], capacity: int) -> None:
        self._count: NDArray[np.int64] = np.frombuffer(buffer[:8], np.int64)
        self._rows: NDArray[np.void] = np.frombuffer(buffer[COUNT_BYTES:], dtype, capacity)
        self.dtype, self._capacity = dtype, capacity
        self._cursor = 0
        self.lost = 0

    @property
    def written(self) -> int:
        """Rows written since the run began."""
        return int(self._count[0])

    @property
    def taken(self) -> int:
        """Rows that this reader has taken, or lost, since the run began."""
        return self._cursor

    def push(self, row: NDArray[np.void] | np.void) -> None:
        """Write one row; never waits."""
        count = int(self._count[0])
        self._rows[count % self._capacity] = row
        self._count[0] = count + 1

    def read(self) -> NDArray[np.void]:
        """Return the rows written since this reader's last call, oldest first."""
        rows, first = self._copy(self._cursor)
        self.lost += first - self._cursor
        self._cursor = first + len(rows)
        return rows

    def last(self, n: int) -> NDArray[np.void]:
        """Return the newest rows, at most `n`, without moving the cursor."""
        return self._copy(max(0, self.written - n))[0]

    def _copy(self, first: int) -> tuple[NDArray[np.void], int]:
        stop = self.written
        # The writer may be filling the oldest slot now: it is never returned.
        first = max(first, stop - self._capacity + 1)
        rows = self._rows[np.arange(first, stop) % self._capacity]
        # The writer may have overwritten the oldest rows while they were copied.
        safe = self.written - self._capacity + 1
        if safe > first:
            rows, first = rows[safe - first :], safe
        return rows, first
