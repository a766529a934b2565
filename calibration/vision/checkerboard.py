"""The checkerboard, and the grid of squares it shares with others: finding it in a picture, checking its colours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision import board, cell_reading
from calibration.vision.board import (
    MIN_CONTRAST_GREY,
    QUIET_SQUARES,
    SIDE_MARGIN,
    SPOTS,
    Board,
    FinestDetail,
    PrintedCells,
)
from calibration.vision.cell_reading import grey_at
from calibration.vision.corners import Corners, refine_corners, spacing
from model.arrays import Array
from model.kernels.jit import kernel

exact_kernel = partial(kernel, sources=(__file__, board.__file__, cell_reading.__file__), fastmath=False)

# How far out into the white margin the colours are checked, in squares.
_QUIET_CHECK = 0.45
# A place no larger than this holds squares so small that the detector sees them better magnified.
_SMALL_PX = 240
_LEAST_SQUARE_PX = 10.0
Box = tuple[int, int, int, int]

# The search runs on a picture of about this width: corners need no more.
_WIDTH_PX = 960
_SMOOTH_PX = 1.3
# A saddle of less curvature [grey / px^2] than a faint board's, or than so many typical ones of the picture, is noise.
_FAINT = 1.5
_ABOVE_NOISE = 7.0
# Saddles much flatter than the strongest ones belong to something else.
_OF_STRONGEST = 0.3
_MOST_SADDLES = 600
# Saddles within so many typical distances belong together, and so many of the board's must be seen.
_TOGETHER = 2.0
_ENOUGH = 0.6
_MOST_PLACES = 3


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


def board_candidates(image: Image, corners: int) -> list[Box]:
    """Boxes (x0, y0, x1, y1) in which a board of so many inner corners may be, the likeliest first.

    They hold clusters of saddle points of the grey values. `cv2.findChessboardCorners` takes half a second to find
    nothing in a noisy 640x480 picture and ten at 1920x1080, so it is only shown places that have the corners' look.
    """
    height, width = image.shape
    scale = max(1, round(width / _WIDTH_PX))
    small = image
    if scale > 1:
        small = np.asarray(
            cv2.resize(image, (width // scale, height // scale), interpolation=cv2.INTER_AREA), dtype=np.uint8
        )
    saddles = _saddles(small, corners)
    if len(saddles) < _ENOUGH * corners:
        return []
    apart = np.linalg.norm(saddles[:, None] - saddles, axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(axis=1)
    reach = _TOGETHER * np.maximum(nearest[:, None], nearest)
    label = _connected((apart <= reach) & (apart <= reach.T))
    sizes = np.bincount(label)
    found = []
    for group in np.argsort(-sizes)[:_MOST_PLACES]:
        if sizes[group] < _ENOUGH * corners:
            break
        members = saddles[label == group]
        margin = 3.0 * float(np.median(nearest[label == group])) + 8
        low = np.maximum((members.min(axis=0) - margin) * scale, 0).astype(int)
        high = np.minimum((members.max(axis=0) + margin) * scale + 1, (width, height)).astype(int)
        found.append((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
    return found


def _connected(linked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Label (n,) of the cluster that each point is in, from which are linked (n, n, symmetric)."""
    label = np.full(len(linked), -1)
    for point in range(len(linked)):
        reached = np.array([point]) if label[point] < 0 else np.empty(0, np.intp)
        while reached.size:
            label[reached] = label[point] if label[point] >= 0 else label.max() + 1
            reached = np.flatnonzero(linked[reached].any(axis=0) & (label < 0))
    return label


def _saddles(image: Image, corners: int) -> Array:
    """Saddle points (k, 2) [px], the strongest of the picture."""
    smooth = cv2.GaussianBlur(image, (0, 0), _SMOOTH_PX).astype(np.float32)
    xx = cv2.Sobel(smooth, cv2.CV_32F, 2, 0, ksize=3, scale=0.25)
    yy = cv2.Sobel(smooth, cv2.CV_32F, 0, 2, ksize=3, scale=0.25)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1, ksize=3, scale=0.25)
    # Minus the determinant of the Hessian: positive at a saddle, none at an edge, negative at a spot.
    strength = cv2.subtract(cv2.multiply(xy, xy), cv2.multiply(xx, yy))
    least = max(_FAINT, _ABOVE_NOISE * float(np.median(np.abs(xy[::4, ::4]))))
    peaks = (strength >= cv2.dilate(strength, np.ones((5, 5), np.uint8))) & (strength > least**2)
    y, x = np.nonzero(peaks)
    found = strength[y, x]
    order = np.argsort(-found)[:_MOST_SADDLES]
    if len(order) == 0:
        return np.empty((0, 2))
    strong = found[order[min(len(order), corners) // 2]]
    order = order[found[order] > _OF_STRONGEST**2 * strong]
    return np.stack([x[order], y[order]], axis=-1).astype(np.float64)
