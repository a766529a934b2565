"""The ChArUco board: a checkerboard with a marker in every white square, of which a part is enough."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.vision.board import PrintedCells
from calibration.vision.checkerboard import SquareGrid
from calibration.vision.marker_board import MarkerBoard, Markers, cells_of
from calibration.vision.partial_corners import CornerKind
from model.arrays import Array


@dataclass(frozen=True)
class CharucoBoard(SquareGrid, MarkerBoard):
    """A checkerboard whose white squares each hold a marker of `marker_m` in the middle.

    Markers are numbered row by row from `first_marker`, as `cv2.aruco.CharucoBoard` does.
    """

    marker_m: float
    dictionary: str = "4X4_50"
    first_marker: int = 0

    @property
    def description(self) -> str:
        return f"ChArUco board of {self.squares_x}x{self.squares_y} squares with markers {self.dictionary}"

    @cached_property
    def markers(self) -> Markers:
        rows, columns = np.nonzero(~self.squares.dark)
        edge = self.marker_m / self.square_m
        ids = self.first_marker + np.arange(len(rows))
        top_left = np.stack([columns, rows], axis=1) + (1 - edge) / 2
        return Markers(ids, np.asarray(top_left, dtype=np.float64), edge, cells_of(self.dictionary, ids))

    @property
    def ground(self) -> PrintedCells:
        return self.squares

    @property
    def white(self) -> float:
        """Between a marker and the edge of its square."""
        return (1 - self.markers.edge) / 2

    @cached_property
    def kind(self) -> CornerKind:
        """Saddles."""
        rows, columns = np.indices(self.pattern[::-1])
        bright = ((rows + columns) % 2 == 1).ravel()
        # The nearest edge is the corner of a marker, across its white square.
        clear_m = float(np.sqrt(2)) * self.white * self.square_m
        return CornerKind(np.ones((len(bright), 2)), bright, clear_m)

    @cached_property
    def plain_m(self) -> Array:
        """Middles of the dark squares."""
        rows, columns = np.nonzero(self.squares.dark)
        return self.at(columns + 0.5, rows + 0.5)
