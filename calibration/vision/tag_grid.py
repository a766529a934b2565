"""A grid of AprilTag or ArUco markers, of which a part is enough."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.vision.board import PrintedCells
from calibration.vision.marker_board import MarkerBoard, Markers, cells_of
from calibration.vision.partial_corners import CornerKind
from model.arrays import Array

# The corner of a tag has no symmetry that cancels what lens and print make of its edges: every tag looks larger or
# smaller than it is. Chosen for coverage with two renderers, see docs/validation/vision.md.
_SYSTEMATIC_PX = 0.02
_UNEXPLAINED = 0.3
_TOWARD = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


@dataclass(frozen=True)
class TagGrid(MarkerBoard):
    """A grid of `tags_x` by `tags_y` tags of `tag_m`, `gap_m` apart, numbered row by row from `first_marker`.

    Corners are those of the tags, clockwise from the top left of each.
    """

    tags_x: int
    tags_y: int
    tag_m: float
    gap_m: float
    dictionary: str = "APRILTAG_36h11"
    first_marker: int = 0

    @property
    def unit_m(self) -> float:
        return self.tag_m

    @property
    def extent(self) -> tuple[float, float]:
        """Width and height of the grid, in tags."""
        pitch = 1 + self.white
        return self.tags_x * pitch - self.white, self.tags_y * pitch - self.white

    @property
    def description(self) -> str:
        return f"grid of {self.tags_x}x{self.tags_y} tags {self.dictionary}"

    @cached_property
    def corners_m(self) -> Array:
        """Corners of the tags (n, 3) in the board's frame."""
        return self._marker_corners_m.reshape(-1, 3)

    @cached_property
    def markers(self) -> Markers:
        rows, columns = (index.ravel() for index in np.indices((self.tags_y, self.tags_x)))
        ids = self.first_marker + np.arange(len(rows))
        top_left = np.stack([columns, rows], axis=1) * (1 + self.white)
        return Markers(ids, np.asarray(top_left, dtype=np.float64), 1.0, cells_of(self.dictionary, ids))

    @property
    def ground(self) -> PrintedCells:
        """White paper."""
        width, height = self.extent
        return PrintedCells(np.array([0.0, width]), np.array([0.0, height]), np.zeros((1, 1), dtype=bool), self.white)

    @property
    def white(self) -> float:
        """Between neighbours."""
        return self.gap_m / self.tag_m

    def spacing(self, corners_px: Array) -> float:
        """Shortest edge [px] of a tag, given all corners (n, 2)."""
        quads = corners_px.reshape(-1, 4, 2)
        return float(np.linalg.norm(quads - np.roll(quads, 1, axis=1), axis=2).min())

    @cached_property
    def kind(self) -> CornerKind:
        """Dark quadrants."""
        tags = len(self.markers.ids)
        # Inside, the nearest edge may be the corner of the first bit; outside, a neighbour.
        clear_m = min(float(np.sqrt(2)) * self.markers.cell, self.white) * self.tag_m
        return CornerKind(
            np.tile(_TOWARD, (tags, 1)),
            np.zeros(4 * tags, dtype=bool),
            clear_m,
            quadrant=True,
            systematic_px=_SYSTEMATIC_PX,
            unexplained=_UNEXPLAINED,
        )
