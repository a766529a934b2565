"""What every kind of board has: corners in its frame, a print, and how it is found and checked in a picture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision.corners import Corners
from model.arrays import Array

# The white margin round the print, in units of the board.
QUIET_SQUARES = 1.0
# A cell is read at five points, so that one noisy pixel does not decide.
_SPREAD = 0.2
SPOTS = np.array([[0, 0], [_SPREAD, _SPREAD], [-_SPREAD, _SPREAD], [_SPREAD, -_SPREAD], [-_SPREAD, -_SPREAD]])
# Between the local dark (0) and the local bright (1) a cell must stand clearly on its side.
SIDE_MARGIN = 0.2
MIN_CONTRAST_GREY = 12.0


@dataclass(frozen=True)
class PrintedCells:
    """What is printed: cells between lines `across` (p + 1,) and `down` (q + 1,), of which `dark` (q, p) are black.

    Lines are in units from the top left corner of the print. White surrounds it, `margin` units wide.
    """

    across: Array
    down: Array
    dark: NDArray[np.bool_]
    margin: float


@dataclass(frozen=True)
class FinestDetail:
    """The smallest thing that a picture must resolve: its name, its size in units, and the pixels that it needs."""

    name: str
    size: float
    least_px: float


class Board(ABC):
    """A flat print with corners at known places.

    Frame: origin at the centre, x to the right, y up and z out of the print as one looks at it.
    """

    @property
    @abstractmethod
    def unit_m(self) -> float:
        """Length [m] in which places on the print are given."""

    @property
    @abstractmethod
    def extent(self) -> tuple[float, float]:
        """Width and height of the print in units."""

    @property
    @abstractmethod
    def description(self) -> str:
        """Kind and counts in a few words."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What to compare with the print where the board is not found."""

    @cached_property
    @abstractmethod
    def corners_m(self) -> Array:
        """Corners (n, 3) in the board's frame."""

    @cached_property
    def edges(self) -> NDArray[np.intp]:
        """Pairs of corners (k, 2) that are one unit apart along x or y."""
        apart = np.abs(self.corners_m[:, None, :2] - self.corners_m[:, :2]) / self.unit_m
        along = np.isclose(apart.sum(axis=2), 1.0) & np.isclose(apart.max(axis=2), 1.0)
        return np.argwhere(np.triu(along))

    @cached_property
    @abstractmethod
    def printed(self) -> PrintedCells:
        """What is printed."""

    @cached_property
    @abstractmethod
    def check_points_m(self) -> Array:
        """Points (k, 3) in the board's frame at which `agrees` reads the grey values."""

    @property
    @abstractmethod
    def finest(self) -> FinestDetail:
        """What a picture must resolve for the board to be found."""

    @abstractmethod
    def find(self, image: Image) -> Array | None:
        """Find the board in a grey picture: every corner (n, 2) [px] to a few pixels, also covered ones.

        None if it is not there, or if it is there twice: which is the rig's cannot be told.
        """

    @abstractmethod
    def refine(self, image: Image, seeds_px: Array) -> Corners | None:
        """Refine the corners that are seen, given all (n, 2) to a few pixels; None if too few are seen."""

    @abstractmethod
    def agrees(self, image: Image, check_points_px: Array) -> bool:
        """Tell whether the picture shows this board there, given where `check_points_m` are seen."""

    @abstractmethod
    def spacing(self, corners_px: Array) -> float:
        """Smallest distance [px] between neighbours of the corners (n, 2)."""

    def at(self, across: NDArray[np.generic], down: NDArray[np.generic]) -> Array:
        """Points (n, 3) [m] given in units from the top left corner of the print."""
        width, height = self.extent
        x = (np.asarray(across, dtype=np.float64) - width / 2) * self.unit_m
        y = (height / 2 - np.asarray(down, dtype=np.float64)) * self.unit_m
        return np.stack([x, y, np.zeros_like(x)], axis=-1)


def grey(image: Image) -> Image:
    """Return the picture as (height, width) grey."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
