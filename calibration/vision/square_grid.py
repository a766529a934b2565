"""The grid of dark and white squares that a checkerboard and a ChArUco board are printed as."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.vision.board import QUIET_SQUARES, Board, PrintedCells
from calibration.vision.corners import spacing
from model.arrays import Array


@dataclass(frozen=True)
class SquareGrid(Board):
    """`squares_x` by `squares_y` squares of `square_m`, the one at the top left dark.

    Corners are the inner corners, row by row from the top, left to right.
    """

    squares_x: int
    squares_y: int
    square_m: float

    @property
    def unit_m(self) -> float:
        return self.square_m

    @property
    def extent(self) -> tuple[float, float]:
        return self.squares_x, self.squares_y

    @property
    def pattern(self) -> tuple[int, int]:
        """Inner corners per row and per column."""
        return self.squares_x - 1, self.squares_y - 1

    @cached_property
    def corners_m(self) -> Array:
        """Inner corners (n, 3) in the board's frame."""
        columns, rows = self.pattern
        return self.at(np.tile(np.arange(1, columns + 1), rows), np.repeat(np.arange(1, rows + 1), columns))

    @cached_property
    def squares(self) -> PrintedCells:
        """The print of the squares alone."""
        rows, columns = np.indices((self.squares_y, self.squares_x))
        across, down = (np.arange(n + 1, dtype=np.float64) for n in self.extent)
        return PrintedCells(across, down, (rows + columns) % 2 == 0, QUIET_SQUARES)

    def spacing(self, corners_px: Array) -> float:
        """Smallest distance [px] between neighbours of the corners (n, 2)."""
        return spacing(corners_px, self.pattern)
