"""Pictures in the shared memory of a run: rings of encoded pictures for the recorder and of frames for viewers.

A ring holds one row for each picture, whose bytes are in a slot of their own. A reader that stalls finds its slot
overwritten and takes no picture from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.realtime.ring import RingBuffer, ring_bytes
from runs.journal.messages import marks_from_bytes, marks_to_bytes
from runs.records import Picture

PICTURES = 32
VIEWS = 4
LINE_POINTS = 16
"""Points of a line of the overlay: the axis of the arm or of an actuator."""

_PICTURE = np.dtype([("t_ns", "<i8"), ("frame", "<i8"), ("camera", "<i8"), ("size", "<i8"), ("marks", "<i8")])


def view_dtype(config: RigConfig) -> np.dtype[np.void]:
    """Row type of the live view of one camera frame of a rig, with its overlay.

    Pixels (u, v) of the board's corners (the first `found` are valid), of the measured tip and of the model's tip,
    NaN where there is none; `lines_m`: axes of the arm and of its actuators in the rod-base frame; `shape`: of the
    picture.
    """
    corners = 0 if config.board is None else config.board.corner_count
    return np.dtype(
        [
            ("number", "<i8"),
            ("t_ns", "<i8"),
            ("frame", "<i8"),
            ("shape", "<i4", (3,)),
            ("found", "<i4"),
            ("corners_px", "<f4", (corners, 2)),
            ("tip_px", "<f4", (2,)),
            ("model_px", "<f4", (2,)),
            ("lines_m", "<f4", (1 + config.actuators, LINE_POINTS, 3)),
        ]
    )


class PictureRing:
    """Encoded pictures with their marks, for the recorder."""

    def __init__(self, rows: memoryview, slots: memoryview, slot_bytes: int) -> None:
        """`rows` has `PictureRing.row_bytes()`, `slots` PICTURES times `slot_bytes`."""
        self._rows = RingBuffer(rows, _PICTURE, PICTURES)
        self._slots, self._slot_bytes = slots, slot_bytes

    @staticmethod
    def row_bytes() -> int:
        """Size of the ring of rows."""
        return ring_bytes(_PICTURE, PICTURES)

    def push(self, picture: Picture, camera: int = 0) -> bool:
        """Store a picture of the `camera`-th camera; False if it is larger than a slot."""
        marks = marks_to_bytes(picture)
        size = len(picture.data)
        if size + len(marks) > self._slot_bytes:
            return False
        start = self._rows.written % PICTURES * self._slot_bytes
        self._slots[start : start + size + len(marks)] = b"".join((picture.data, marks))
        self._rows.push(np.array((picture.t_ns, picture.frame, camera, size, len(marks)), _PICTURE))
        return True

    def read(self, cameras: Sequence[str], encoding: str) -> list[Picture]:
        """Return the pictures stored since the last call; `cameras` are their names, in the rig's order."""
        pictures = []
        rows = self._rows.read()
        for number, row in enumerate(rows, self._rows.taken - len(rows)):
            t_ns, frame, camera, size, marks_size = row.tolist()
            start = number % PICTURES * self._slot_bytes
            end = start + size
            data, seen = bytes(self._slots[start:end]), bytes(self._slots[end : end + marks_size])
            # After a stall of this reader the writer may have overwritten the slot while it was copied.
            if self._rows.written - number >= PICTURES:
                self._rows.lost += 1
                continue
            _, _, marks = marks_from_bytes(seen)
            pictures.append(Picture(t_ns, frame, cameras[camera], encoding, data, marks))
        return pictures

    @property
    def lost(self) -> int:
        """Pictures overwritten before this reader took them."""
        return self._rows.lost


class ViewRing:
    """The newest frames with their overlays, for viewers."""

    def __init__(self, rows: memoryview, slots: memoryview, slot_bytes: int, dtype: np.dtype[np.void]) -> None:
        """`rows` has `ring_bytes(dtype, VIEWS)`, `slots` VIEWS times `slot_bytes`; `dtype` is a `view_dtype`."""
        self._rows = RingBuffer(rows, dtype, VIEWS)
        self._slots, self._slot_bytes = slots, slot_bytes

    def push(self, view: NDArray[np.void], image: NDArray[np.uint8]) -> None:
        """Publish a frame: a row of `view_dtype`, whose number is set here, and its picture."""
        number = self._rows.written
        pixels = np.ascontiguousarray(image).tobytes()
        if len(pixels) > self._slot_bytes:
            return
        start = number % VIEWS * self._slot_bytes
        self._slots[start : start + len(pixels)] = pixels
        view["number"] = number
        self._rows.push(view)

    def newest(self, after: int = -1) -> tuple[NDArray[np.void], NDArray[np.uint8]] | None:
        """Return the newest frame with a number above `after`; None if there is none or it was overwritten."""
        if self._rows.written <= after + 1:
            return None
        rows = self._rows.last(1)
        if not len(rows) or int(rows["number"][0]) <= after:
            return None
        number, shape = int(rows["number"][0]), rows["shape"][0]
        start = number % VIEWS * self._slot_bytes
        image = np.frombuffer(self._slots[start : start + int(shape.prod())], np.uint8).reshape(shape).copy()
        return (rows[0], image) if self._rows.written - number < VIEWS else None
