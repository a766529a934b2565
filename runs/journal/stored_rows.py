"""Rows and pictures of a journal, read lazily from the memory-mapped file.

Only an index is in memory, 16 bytes per block or picture, so runs of any length are readable.
"""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray

from runs.journal import mcap_records, messages
from runs.records import ImageAnnotations, Picture, blank


class StoredRows:
    """Rows of one kind; a slice of them is an array (n,) of its own."""

    def __init__(self, data: memoryview, stored: np.dtype[np.void], kind: np.dtype[np.void], index: Index) -> None:
        """`stored` is the dtype of a row in the file `data`, `kind` the one that rows are returned as."""
        self._kind = kind
        self._begins, self._ends = (np.frombuffer(column, np.int64) for column in (index.begins, index.ends))
        self._stride = mcap_records.framed(stored).itemsize
        # Rows are not aligned.
        places = max(0, len(data) - stored.itemsize + 1)
        self._everywhere: NDArray[np.void] = np.ndarray(places, stored, data, 0, (1,))

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, part: slice) -> NDArray[np.void]:
        number = np.arange(*part.indices(len(self)))
        if len(number) == 0:
            return np.zeros(0, self._kind)
        block = np.searchsorted(self._ends, number, side="right")
        before = np.where(block > 0, self._ends[block - 1], 0)
        return _as_rows(self._everywhere[self._begins[block] + (number - before) * self._stride], self._kind)


class Index:
    """Start positions of the blocks of one kind of row."""

    def __init__(self) -> None:
        self.begins, self.ends = array("q"), array("q")

    def add(self, begin: int, rows: int) -> None:
        """Add a block by the position of its first row."""
        self.begins.append(begin)
        self.ends.append((self.ends[-1] if self.ends else 0) + rows)


class StoredPictures:
    """The pictures; a slice of them is a list whose `data` are views of the mapped file."""

    def __init__(self, data: memoryview) -> None:
        self.utc_minus_t_ns = 0
        self.corners = self.backbone = 0
        """The most corners, and points of the backbone, that any picture has."""
        self._data = data
        self._pictures, self._marks = array("q"), array("q")
        self._unclaimed: dict[tuple[int, str], int] = {}

    def mark(self, position: int) -> None:
        """Add the annotations message at a position; its picture follows."""
        frame, camera, marks = self._marks_at(position)
        self._unclaimed[frame & 0xFFFFFFFF, camera] = position
        self.corners = max(self.corners, len(marks.corners_px))
        self.backbone = max(self.backbone, len(marks.backbone_px))

    def picture(self, position: int) -> None:
        """Add the picture message at a position."""
        found = self._picture_at(position, ImageAnnotations.none())
        self._pictures.append(position)
        self._marks.append(self._unclaimed.pop((found.frame, found.camera), 0))

    def __len__(self) -> int:
        return len(self._pictures)

    def __getitem__(self, part: slice) -> list[Picture]:
        return [
            self._picture_at(position, self._marks_at(marks)[2] if marks else ImageAnnotations.none())
            for position, marks in zip(self._pictures[part], self._marks[part], strict=True)
        ]

    def _picture_at(self, position: int, marks: ImageAnnotations) -> Picture:
        _, log_ns, payload = mcap_records.message_at(self._data, position)
        frame, camera, encoding, begin = messages.picture_from_bytes(payload[:512].tobytes())
        return Picture(log_ns - self.utc_minus_t_ns, frame, camera, encoding, payload[begin:], marks)

    def _marks_at(self, position: int) -> tuple[int, str, ImageAnnotations]:
        return messages.marks_from_bytes(mcap_records.message_at(self._data, position)[2].tobytes())


def _as_rows(rows: NDArray[np.void], kind: np.dtype[np.void]) -> NDArray[np.void]:
    """Return rows with the current columns; one that the journal lacks is as in a blank record."""
    if rows.dtype == kind:
        return rows
    known = blank(len(rows), kind)
    for name in kind.names or ():
        if rows.dtype.names and name in rows.dtype.names and rows[name].shape == known[name].shape:
            known[name] = rows[name]
    return known
