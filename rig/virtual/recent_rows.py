"""Recent rows of a run in virtual time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class RecentRows:
    """Rows of a run: keeps the recent ones, and returns new ones once for the record."""

    def __init__(self, dtype: np.dtype[np.void], history: int) -> None:
        self._history = history
        self._rows = np.zeros(2 * history, dtype)
        self._filled = 0
        self._taken = 0

    def extend(self, row: bytes) -> None:
        self.add(np.frombuffer(row, self._rows.dtype)[0])

    def add(self, row: NDArray[np.void] | np.void) -> None:
        if self._filled == len(self._rows):
            drop = min(self._taken, self._history)
            self._rows[: self._filled - drop] = self._rows[drop : self._filled].copy()
            self._filled -= drop
            self._taken -= drop
        self._rows[self._filled] = row
        self._filled += 1

    def take(self) -> NDArray[np.void]:
        rows = self._rows[self._taken : self._filled]
        self._taken = self._filled
        return rows

    def recent(self, n: int) -> NDArray[np.void]:
        return self._rows[max(0, self._filled - n) : self._filled]
