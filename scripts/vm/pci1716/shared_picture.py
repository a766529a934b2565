"""The memory that the bench shares with the guest: what its camera and its gauge show."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

SIZE_BYTES = 1 << 20
PICTURE_AT = 4096
ACTUATORS = 3

HEADER = np.dtype(
    [
        ("sequence", "<u8"),
        ("t_ns", "<i8"),
        ("chamber_pa", "<f8", ACTUATORS),
        ("tip_m", "<f8", 3),
        ("period_us", "<u4"),
        ("subject", "<u4"),
    ]
)
"""`sequence` is odd while the bench writes; the guest writes `period_us` (0: the camera is off) and `subject`."""


class Subject(IntEnum):
    """What stands before the camera."""

    TIP = 0
    BOARD_IN_HAND = 1
    BOARD_ON_THE_BASE = 2


class SharedPicture:
    """Header and picture (height, width, 2), YUYV of video range, in a memory that is mapped by both sides."""

    def __init__(self, memory: object, width_px: int, height_px: int) -> None:
        self.header: NDArray[np.void] = np.frombuffer(memory, HEADER, 1)  # type: ignore[call-overload]
        count = width_px * height_px * 2
        self.yuyv: NDArray[np.uint8] = np.frombuffer(memory, np.uint8, count, PICTURE_AT).reshape(  # type: ignore[call-overload]
            height_px, width_px, 2
        )

    @property
    def sequence(self) -> int:
        """Twice the number of pictures so far; odd while one is written."""
        return int(self.header["sequence"][0])
