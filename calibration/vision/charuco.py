"""The ChArUco board: a checkerboard with a marker in every white square, of which a part is enough."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.vision.board import QUIET_SQUARES, BoardPrint
from calibration.vision.corners import spacing
from calibration.vision.marker_board import MarkerBoard, Markers, cells_of
from calibration.vision.partial_corners import CornerKind

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CharucoBoard(MarkerBoard):
    """A board of `squares_x` by `squares_y` squares of `square_m`, the one at the top left dark.

    Each white square holds a marker of `marker_m` in its middle; they are numbered row by row from `first_marker`, as
    `cv2.aruco.CharucoBoard` does. Corners are the inner corners, row by row from the top, left to right.
    """

    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float
    dictionary: str = "4X4_50"
    first_marker: int = 0

    @property
    def unit_m(self) -> float:
        """One square."""
        return self.square_m

    @property
    def extent(self) -> tuple[float, float]:
        """Squares across and down."""
        return self.squares_x, self.squares_y

    @property
    def pattern(self) -> tuple[int, int]:
        """Inner corners per row and per column."""
        return self.squares_x - 1, self.squares_y - 1

    @cached_property
    def corners_m(self) -> Floats:
        """Inner corners (n, 3) in the board's frame."""
        columns, rows = self.pattern
        return self.at(np.tile(np.arange(1, columns + 1), rows), np.repeat(np.arange(1, rows + 1), columns))

    @cached_property
    def markers(self) -> Markers:
        """One in each white square."""
        rows, columns = np.nonzero(~self.ground.dark)
        edge = self.marker_m / self.square_m
        ids = self.first_marker + np.arange(len(rows))
        top_left = np.stack([columns, rows], axis=1) + (1 - edge) / 2
        return Markers(ids, np.asarray(top_left, dtype=np.float64), edge, cells_of(self.dictionary, ids))

    @property
    def ground(self) -> BoardPrint:
        """The squares."""
        rows, columns = np.indices((self.squares_y, self.squares_x))
        across, down = (np.arange(n + 1, dtype=np.float64) for n in self.extent)
        return BoardPrint(across, down, (rows + columns) % 2 == 0, QUIET_SQUARES)

    @property
    def white(self) -> float:
        """Between a marker and the edge of its square."""
        return (1 - self.markers.edge) / 2

    def spacing(self, corners_px: Floats) -> float:
        """Smallest distance [px] between neighbours of the corners (n, 2)."""
        return spacing(corners_px, self.pattern)

    @cached_property
    def kind(self) -> CornerKind:
        """Saddles."""
        rows, columns = np.indices(self.pattern[::-1])
        bright = ((rows + columns) % 2 == 1).ravel()
        # The nearest edge is the corner of a marker, across its white square.
        clear_m = float(np.sqrt(2)) * self.white * self.square_m
        return CornerKind(np.ones((len(bright), 2)), bright, clear_m)

    @cached_property
    def plain_m(self) -> Floats:
        """Middles of the dark squares."""
        rows, columns = np.nonzero(self.ground.dark)
        return self.at(columns + 0.5, rows + 0.5)
