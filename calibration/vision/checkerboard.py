"""The checkerboard: finding it in a whole picture, and checking its colours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision import board, cell_reading
from calibration.vision.board import MIN_CONTRAST_GREY, SIDE_MARGIN, SPOTS, FinestDetail, PrintedCells
from calibration.vision.board_candidates import board_candidates
from calibration.vision.cell_reading import grey_at
from calibration.vision.corners import Corners, refine_corners
from calibration.vision.square_grid import SquareGrid
from model.arrays import Array
from model.kernels.jit import kernel

exact_kernel = partial(kernel, sources=(__file__, board.__file__, cell_reading.__file__), fastmath=False)

# How far out into the white margin the colours are checked, in squares.
_QUIET_CHECK = 0.45
# A place no larger than this holds squares so small that the detector sees them better magnified.
_SMALL_PX = 240
_LEAST_SQUARE_PX = 10.0


@dataclass(frozen=True)
class Checkerboard(SquareGrid):
    """A checkerboard; one count of squares is odd and the other even.

    The board must be seen as a whole: with some corners hidden, nothing tells a grid from one that lies a square
    beside it.
    """

    @property
    def description(self) -> str:
        return f"board of {self.squares_x - 1}x{self.squares_y - 1} inner corners"

    @property
    def remedy(self) -> str:
        return "count the inner corners, not the squares"

    @property
    def printed(self) -> PrintedCells:
        return self.squares

    @property
    def finest(self) -> FinestDetail:
        """A square; with 6 px it is still found, with large errors."""
        return FinestDetail("square", 1.0, _LEAST_SQUARE_PX)

    @cached_property
    def check_points_m(self) -> Array:
        """Points (cells * 5, 3) at which colours are checked: every square, and the quiet zone's ring of cells."""
        across = np.concatenate([[-_QUIET_CHECK], np.arange(self.squares_x) + 0.5, [self.squares_x + _QUIET_CHECK]])
        down = np.concatenate([[-_QUIET_CHECK], np.arange(self.squares_y) + 0.5, [self.squares_y + _QUIET_CHECK]])
        u, v = np.meshgrid(across, down)
        return self.at((u.reshape(-1, 1) + SPOTS[:, 0]).ravel(), (v.reshape(-1, 1) + SPOTS[:, 1]).ravel())

    @cached_property
    def dark(self) -> NDArray[np.bool_]:
        """Which cells of the check (cells,) must be dark."""
        cells = np.zeros((self.squares_y + 2, self.squares_x + 2), dtype=bool)
        cells[1:-1, 1:-1] = self.squares.dark
        return cells.ravel()

    @cached_property
    def _shading(self) -> Array:
        """Base (cells, 3) of a plane over the cells: lighting may fall off across the board."""
        rows, columns = np.indices((self.squares_y + 2, self.squares_x + 2))
        return np.stack([np.ones(rows.size), rows.ravel() - rows.mean(), columns.ravel() - columns.mean()], axis=-1)

    @cached_property
    def _shading_fits(self) -> tuple[Array, Array]:
        """Least-squares operators of the bright and the dark cells' planes."""
        bright, dark = self._shading[~self.dark], self._shading[self.dark]
        return np.ascontiguousarray(np.linalg.pinv(bright)), np.ascontiguousarray(np.linalg.pinv(dark))

    def agrees(self, image: Image, check_points_px: Array) -> bool:
        """Tell whether every square and the quiet zone have their colours, given where `check_points_m` are seen.

        This is what catches a corner grid that lies one or more squares beside the print, and a board that is
        partly covered: reprojection cannot see the first and hardly the second.
        """
        to_bright, to_dark = self._shading_fits
        return bool(_sides_fit(image, check_points_px, self.dark, self._shading, to_bright, to_dark))

    def find(self, image: Image) -> Array | None:
        """Find all corners to about a pixel, in the board's order."""
        corners = []
        for x0, y0, x1, y1 in board_candidates(image, self.pattern[0] * self.pattern[1]):
            found = _find_in(np.ascontiguousarray(image[y0:y1, x0:x1]), self)
            if found is not None:
                corners.append(found + np.array([x0, y0]))
        return corners[0] if len(corners) == 1 else None

    def refine(self, image: Image, seeds_px: Array) -> Corners | None:
        """Refine all corners; None where one has no model."""
        return refine_corners(image, seeds_px, self.pattern)


@exact_kernel
def _sides_fit(
    image: Image, spots_px: Array, dark: NDArray[np.bool_], shading: Array, to_bright: Array, to_dark: Array
) -> bool:
    """Tell whether cells (n,), read at spots (5 n, 2), stand on the sides that `dark` (n,) says.

    They do not where a spot lies outside the picture.
    """
    cells, spots = len(dark), len(spots_px) // len(dark)
    grey = np.zeros(cells)
    for k in range(len(spots_px)):
        x, y = spots_px[k]
        value = grey_at(image, x, y)
        if math.isnan(value):
            return False
        grey[k // spots] += value / spots
    bright_plane, dark_plane = np.zeros(3), np.zeros(3)
    brights = darks = 0
    for k in range(cells):
        if dark[k]:
            for i in range(3):
                dark_plane[i] += to_dark[i, darks] * grey[k]
            darks += 1
        else:
            for i in range(3):
                bright_plane[i] += to_bright[i, brights] * grey[k]
            brights += 1
    for k in range(cells):
        low = high = 0.0
        for i in range(3):
            low += shading[k, i] * dark_plane[i]
            high += shading[k, i] * bright_plane[i]
        if not high - low >= MIN_CONTRAST_GREY:
            return False
        side = (grey[k] - low) / (high - low) - 0.5
        if not (-side if dark[k] else side) > SIDE_MARGIN:
            return False
    return True


def _find_in(image: Image, board: Checkerboard) -> Array | None:
    """Search a small picture. The detector does not know which end of the board is which; the colours decide."""
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, raw = cv2.findChessboardCorners(image, board.pattern, flags=flags)
    magnified = 1
    if not found and max(image.shape) < _SMALL_PX:
        magnified = 2
        larger = np.asarray(cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
        found, raw = cv2.findChessboardCorners(larger, board.pattern, flags=flags)
    if not found:
        return None
    # Magnified about the picture's corner: a pixel's centre moves with it.
    corners = (np.asarray(raw, dtype=np.float64).reshape(board.pattern[1], board.pattern[0], 2) + 0.5) / magnified - 0.5
    along, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    if along[0] * down[1] - along[1] * down[0] < 0:  # seen from the front, rows run clockwise before columns
        corners = corners[::-1]
    for candidate in (corners, corners[::-1, ::-1]):
        points = np.ascontiguousarray(candidate.reshape(-1, 2))
        to_image, _ = cv2.findHomography(board.corners_m[:, :2], points)
        if to_image is None:
            return None
        check = cv2.perspectiveTransform(board.check_points_m[:, None, :2], to_image)[:, 0, :]
        if board.agrees(image, np.asarray(check, dtype=np.float64)):
            return points
    return None
