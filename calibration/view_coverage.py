"""Coverage of a camera calibration by its views, and advice for the next view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.corner_search import SeenCorners
from calibration.vision.board import Board
from calibration.vision.lens import Lens
from model.arrays import Array

REGIONS = (
    ("the top left", "the top", "the top right"),
    ("the left", "the middle", "the right"),
    ("the bottom left", "the bottom", "the bottom right"),
)
"""Ninths of the picture, by rows."""
TILTS = ("the left edge nearer", "the right edge nearer", "the top edge nearer", "the bottom edge nearer")
_TURNS = ("turn its left edge towards the camera", "turn its right edge towards the camera",
          "lean its top towards the camera", "lean its bottom towards the camera")  # fmt: skip
ENOUGH_TILT_DEG = 15.0
ENOUGH_VIEWS = 10
# Fraction of the picture's width or height that the board should fill in some view.
_NEAR = 0.4
_ENOUGH_REGIONS = 7
_MOVES = (("up", "down"), ("left", "right"))
# How much a new view must differ from every other to be worth keeping, as shares of the picture.
_NEW = 0.08


@dataclass(frozen=True)
class ViewGeometry:
    """One view: corners, and the lean (2,) [deg] of the board, left edge nearer and top edge nearer."""

    corners: SeenCorners
    lean_deg: Array


def view_geometry(board: Board, seen: SeenCorners, size: tuple[int, int], lens: Lens | None = None) -> ViewGeometry:
    """A view by its corners; the lean is rough where the lens is not known yet."""
    width, height = size
    usual = 1.1 * max(size)
    through = lens or Lens.of(usual, usual, width / 2, height / 2)
    # IPPE expects a plane whose z axis points away from the camera.
    points = board.corners_m[seen.which] * (1.0, -1.0, 0.0) / board.unit_m
    found, turn, place = cv2.solvePnP(points, seen.px, through.matrix, through.distortion, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        return ViewGeometry(seen, np.zeros(2))
    normal = cv2.Rodrigues(turn)[0][:, 2]
    sight = place.ravel() / np.linalg.norm(place)
    if normal @ sight < 0:
        normal = -normal
    # The normal points away from the camera. Where it leans to the right, the right edge is the nearer one.
    off = normal - sight * float(normal @ sight)
    return ViewGeometry(seen, np.degrees(np.arcsin(np.clip([-off[0], -off[1]], -1, 1))))


class ViewCoverage:
    """Coverage of picture, tilt and distance by the views."""

    def __init__(self, size: tuple[int, int], looks: Sequence[ViewGeometry] = ()) -> None:
        """`size` is (width, height) [px]."""
        self._size = np.array(size, dtype=np.float64)
        self._looks: list[ViewGeometry] = list(looks)

    def add(self, view: ViewGeometry) -> None:
        """Add a view."""
        self._looks.append(view)

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self._looks)

    def is_new(self, view: ViewGeometry) -> bool:
        """Tell whether a view differs from every other in place, size or lean."""
        return all(_apart(view, other, self._size) > _NEW for other in self._looks)

    def heat(self, columns: int = 16, rows: int = 12) -> NDArray[np.int64]:
        """How many corners each cell (rows, columns) of the picture has seen."""
        counts = np.zeros((rows, columns), np.int64)
        for view in self._looks:
            x, y = np.floor(view.corners.px / self._size * (columns, rows)).astype(int).T
            inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
            np.add.at(counts, (y[inside], x[inside]), 1)
        return counts

    @property
    def share(self) -> float:
        """Share of the picture, in cells of a twelfth, in which some corner was seen."""
        return float((self.heat(4, 3) > 0).mean())

    def missing_regions(self) -> tuple[str, ...]:
        """Ninths of the picture in which no corner was seen."""
        seen = self.heat(3, 3)
        return tuple(REGIONS[r][c] for r in range(3) for c in range(3) if not seen[r, c])

    def missing_tilts(self) -> tuple[str, ...]:
        """Leans that no view shows."""
        return tuple(name for name, most in zip(TILTS, self._leans(), strict=True) if most < ENOUGH_TILT_DEG)

    def _leans(self) -> tuple[float, ...]:
        """The largest lean [deg] each way, in the order of TILTS."""
        leans = np.array([view.lean_deg for view in self._looks]).reshape(-1, 2)
        signed = np.column_stack([leans[:, 0], -leans[:, 0], leans[:, 1], -leans[:, 1]])
        return tuple(signed.max(axis=0, initial=0.0).tolist())

    def _nearest(self) -> float:
        """The largest share of the picture's width or height that the board filled."""
        return max((float((np.ptp(v.corners.px, axis=0) / self._size).max()) for v in self._looks), default=0.0)

    def advice(self) -> tuple[str, ...]:
        """Advice for more views; empty if the coverage is complete."""
        wants = []
        if self.views < ENOUGH_VIEWS:
            wants.append(f"take at least {ENOUGH_VIEWS} views; {self.views} could be used")
        regions, tilts = self.missing_regions(), self.missing_tilts()
        if 9 - len(regions) < _ENOUGH_REGIONS:
            wants.append(
                f"show the board near the edges and corners too: it covered {self.share:.0%} of the picture, "
                f"nothing in {_listed(regions)}"
            )
        leans = self._leans()
        if max(leans[:2]) < ENOUGH_TILT_DEG or max(leans[2:]) < ENOUGH_TILT_DEG:
            wants.append(
                f"tilt the board by 20 to 45 deg, for the focal length: no view has {_listed(tilts)} "
                f"(largest lean {max(leans):.0f} deg)"
            )
        if self._nearest() < _NEAR:
            wants.append(f"bring the board nearer: it filled {self._nearest():.0%} of the picture at most")
        return tuple(wants)

    def next_step(self, now: ViewGeometry | None) -> str:
        """Advice for the next view; empty if the coverage is complete."""
        regions, tilts = self.missing_regions(), self.missing_tilts()
        if now is None:
            return "hold the whole board into the picture, evenly lit"
        if regions:
            row, column = next((r, c) for r in range(3) for c in range(3) if REGIONS[r][c] == regions[0])
            low, high = now.corners.px.min(axis=0) / self._size, now.corners.px.max(axis=0) / self._size
            ways = []
            for axis, third in ((1, row), (0, column)):
                if low[axis] > (third + 0.8) / 3:
                    ways.append(_MOVES[1 - axis][0])
                elif high[axis] < (third + 0.2) / 3:
                    ways.append(_MOVES[1 - axis][1])
            return f"move the board further {' and '.join(ways) or 'that way'}, until it covers {regions[0]}"
        if tilts:
            return f"tilt more: {_TURNS[TILTS.index(tilts[0])]} by 20 to 40 deg"
        if self._nearest() < _NEAR:
            return f"closer: the board should fill half of the picture, now {self._nearest():.0%}"
        if self.views < ENOUGH_VIEWS:
            return f"another distance or tilt: {ENOUGH_VIEWS - self.views} more views"
        return ""


def _apart(a: ViewGeometry, b: ViewGeometry, size: Array) -> float:
    """How much two views differ: the corners' mean way across the picture, and the lean (45 deg are a picture).

    Views that show no corner in common differ by a whole picture.
    """
    here, there = a.corners.shared(b.corners)
    way = float(np.mean(np.linalg.norm((here - there) / size, axis=1))) if len(here) else 1.0
    return max(way, float(np.abs(a.lean_deg - b.lean_deg).max()) / 45)


def _listed(names: Sequence[str]) -> str:
    return " or ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} or {names[-1]}"
