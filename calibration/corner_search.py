"""Corners of a calibration board in a whole picture, which may show only a part of a board with markers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision.board import Board
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.corners import refine_corners, spacing
from model.arrays import Array

_WHITE, _BLACK = 250, 16
"""Grey levels at and above, at and below which a pixel shows no detail."""
_MOST_WHITE = 0.25
_MOST_BLACK = 0.9


_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SUBPIX = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
# Boards are sought in pictures of at most this width: corners need no more, and they are sharpened in the whole one.
_WIDTH_PX = 1000


@dataclass(frozen=True)
class SeenCorners:
    """Corners of a board in one picture: `which` (n,) of the board's corners, and where they are seen, `px` (n, 2)."""

    which: NDArray[np.intp]
    px: Array

    def shared(self, other: SeenCorners) -> tuple[Array, Array]:
        """Places (k, 2) [px] of the corners that both pictures show, in this one and in the other."""
        _, own, others = np.intersect1d(self.which, other.which, assume_unique=True, return_indices=True)
        return self.px[own], other.px[others]


@singledispatch
def seen_corners(board: Board, image: Image) -> SeenCorners | None:
    """Corners of the board in a grey picture, to sub-pixel; None if it is not found."""
    seeds = board.find(image)
    corners = None if seeds is None else board.refine(image, seeds)
    return None if corners is None else SeenCorners(corners.index, corners.px)


@seen_corners.register
def _(board: Checkerboard, image: Image) -> SeenCorners | None:
    px = find_corners(image, board.pattern)
    return None if px is None else every_corner(px)


def every_corner(px: Array) -> SeenCorners:
    """All corners of a board, seen at `px` (n, 2)."""
    return SeenCorners(np.arange(len(px)), px)


@singledispatch
def orderings(board: Board, seen: SeenCorners) -> tuple[SeenCorners, ...]:
    """The corners in every order that the board's symmetry permits; markers permit one."""
    return (seen,)


@orderings.register
def _(board: Checkerboard, seen: SeenCorners) -> tuple[SeenCorners, ...]:
    columns, rows = board.pattern
    grid = seen.px.reshape(rows, columns, 2)
    turns = [grid]
    if (columns + rows) % 2 == 0:
        turns.append(grid[::-1, ::-1])
    if columns == rows:
        turns += [np.rot90(grid, 1), np.rot90(grid, 3)]
    return tuple(every_corner(np.ascontiguousarray(turned.reshape(-1, 2))) for turned in turns)


def no_board(image: Image, board: Board) -> str:
    """Return the reason for a grey picture in which the board was not found."""
    return with_exposure(f"no {board.description} found", image)


def with_exposure(reason: str, image: Image) -> str:
    """Return the reason, followed by the exposure fault of the picture if it has one."""
    return f"{reason}; {fault}" if (fault := exposure_fault(image)) else reason


def find_corners(image: Image, corners: tuple[int, int]) -> Array | None:
    """Corners (n, 2) of any checkerboard in a grey picture, to sub-pixel, in rows as seen from the print's front.

    The colours determine which end comes first where one count is odd and the other even, the first square between
    corners being the dark one; on other boards it is left open.
    """
    seeds = _seeds(image, corners)
    if seeds is None:
        return None
    sharp = refine_corners(image, seeds, corners)
    if sharp is not None:
        return sharp.px
    half = max(2, int(0.4 * spacing(seeds, corners)))
    refined = cv2.cornerSubPix(image, seeds.astype(np.float32).reshape(-1, 1, 2), (half, half), (-1, -1), _SUBPIX)
    return np.asarray(refined[:, 0, :], dtype=np.float64)


def _seeds(image: Image, corners: tuple[int, int]) -> Array | None:
    """Corners (n, 2) to about a pixel."""
    scale = max(1, -(-image.shape[1] // _WIDTH_PX))
    for factor in (scale, 1) if scale > 1 else (1,):
        small = image
        if factor > 1:
            size = (image.shape[1] // factor, image.shape[0] // factor)
            small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        # At full width only what looks like a board is searched: a picture without one takes seconds otherwise.
        fast = cv2.CALIB_CB_FAST_CHECK if factor < scale else 0
        found, raw = cv2.findChessboardCorners(small, corners, flags=_FLAGS | fast)
        if not found and not fast:
            found, raw = cv2.findChessboardCornersSB(small, corners, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if found:
            # A pixel's centre moves with the scale.
            seeds = (np.asarray(raw, dtype=np.float64).reshape(corners[1], corners[0], 2) + 0.5) * factor - 0.5
            return _in_order(image, seeds).reshape(-1, 2)
    return None


def _in_order(image: Image, grid: Array) -> Array:
    """Corners (rows, columns, 2) in the order that the colours determine."""
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if along[0] * down[1] - along[1] * down[0] < 0:  # seen from the front, rows run clockwise before columns
        grid = grid[::-1]
    rows, columns = grid.shape[:2]
    if (rows + columns) % 2 == 0:
        return grid
    middles = (grid[1:, 1:] + grid[1:, :-1] + grid[:-1, 1:] + grid[:-1, :-1]) / 4
    spots = middles.astype(np.float32)
    greys = cv2.remap(image, spots[..., 0], spots[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    first = np.indices(greys.shape).sum(axis=0) % 2 == 0
    return grid if greys[first].mean() < greys[~first].mean() else grid[::-1, ::-1]


def exposure_fault(image: NDArray[np.uint8]) -> str:
    """Return the exposure fault of a grey picture (height, width) with the share of pixels; empty if there is none."""
    white, black = float(np.mean(image >= _WHITE)), float(np.mean(image <= _BLACK))
    if white > _MOST_WHITE:
        return f"the picture is overexposed ({100 * white:.0f} % of its pixels are white)"
    if black > _MOST_BLACK:
        return f"the picture is underexposed ({100 * black:.0f} % of its pixels are black)"
    return ""
