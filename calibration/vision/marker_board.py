"""Boards with square markers that say which is which: found and checked by the markers that are seen."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision.board import MIN_CONTRAST_GREY, SIDE_MARGIN, SPOTS, Board, FinestDetail, PrintedCells
from calibration.vision.cell_reading import markers_seen
from calibration.vision.corners import Corners
from calibration.vision.partial_corners import CornerKind, refine_seen_corners
from calibration.vision.plane_map import mapped, plane_to_image
from model.arrays import Array

# Markers seen, if the board has so many: one alone is read out of clutter too easily.
_LEAST_MARKERS = 2
_LEAST_CELL_PX = 3.0
# A marker that lies so far [px] off where the others place it is another thing, or a wrong reading.
_OFF_PLANE_PX = 3.0
LEAST_CORNERS = 4
"""Corners that a pose needs."""
# Corners in a band so narrow, as a share of its length, give no pose.
_LEAST_WIDTH = 0.1


@dataclass(frozen=True)
class Markers:
    """The markers of a board: `ids` (m,), the `top_left` (m, 2) in units and the `edge`, and their `cells` (m, k, k).

    A cell of a marker is True where it is dark; the outermost ones are its dark rim.
    """

    ids: NDArray[np.intp]
    top_left: Array
    edge: float
    cells: NDArray[np.bool_]

    @property
    def cell(self) -> float:
        """Edge of one cell in units."""
        return float(self.edge / self.cells.shape[1])


@lru_cache(maxsize=8)
def dictionary_named(name: str) -> cv2.aruco.Dictionary:
    """A family of markers."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def cells_of(name: str, ids: NDArray[np.intp]) -> NDArray[np.bool_]:
    """The cells (m, k, k) of markers, True where dark."""
    family = dictionary_named(name)
    edge = family.markerSize + 2
    return np.stack([cv2.aruco.generateImageMarker(family, int(k), edge) == 0 for k in ids])


class MarkerBoard(Board):
    """A board whose markers tell its corners apart, so that a part of it is enough."""

    dictionary: str
    """Name of the family of markers."""

    @property
    def remedy(self) -> str:
        """Markers of another family or with other numbers are another board."""
        return "compare its counts, its family of markers and its first marker with the print"

    @property
    def finest(self) -> FinestDetail:
        """A cell of a marker: the detector misreads smaller ones."""
        return FinestDetail("cell of a marker", self.markers.cell, _LEAST_CELL_PX)

    @cached_property
    @abstractmethod
    def markers(self) -> Markers:
        """The markers."""

    @property
    @abstractmethod
    def ground(self) -> PrintedCells:
        """The print without its markers."""

    @cached_property
    def printed(self) -> PrintedCells:
        """The ground with the markers: lines at every edge of a cell."""
        ground, markers = self.ground, self.markers
        steps = np.arange(markers.cells.shape[1] + 1) * markers.cell
        across = _merged(np.concatenate([ground.across, (markers.top_left[:, :1] + steps).ravel()]))
        down = _merged(np.concatenate([ground.down, (markers.top_left[:, 1:] + steps).ravel()]))
        x, y = (across[1:] + across[:-1]) / 2, (down[1:] + down[:-1]) / 2
        column = np.searchsorted(ground.across, x) - 1
        row = np.searchsorted(ground.down, y) - 1
        dark = ground.dark[np.ix_(row, column)]
        for (left, top), cells in zip(markers.top_left, markers.cells, strict=True):
            i, j = (y - top) / markers.cell, (x - left) / markers.cell
            inside_y, inside_x = (i > 0) & (i < len(cells)), (j > 0) & (j < len(cells))
            dark[np.ix_(inside_y, inside_x)] = cells[np.ix_(i[inside_y].astype(int), j[inside_x].astype(int))]
        return PrintedCells(across, down, dark, ground.margin)

    @cached_property
    def check_points_m(self) -> Array:
        """Five points of every cell of the markers and of the ring around each (m * (k + 2)^2 * 5, 3)."""
        markers = self.markers
        # The ring is narrower than a cell where the white around the marker is.
        out = min(0.5, 0.5 * self.white / markers.cell)
        k = markers.cells.shape[1]
        line = np.concatenate([[-out], np.arange(k) + 0.5, [k + out]])
        v, u = np.meshgrid(line, line, indexing="ij")
        u = markers.top_left[:, None, None, 0] + (u[..., None] + SPOTS[:, 0])[None].reshape(1, -1, 5) * markers.cell
        v = markers.top_left[:, None, None, 1] + (v[..., None] + SPOTS[:, 1])[None].reshape(1, -1, 5) * markers.cell
        return self.at(u.ravel(), v.ravel())

    @property
    @abstractmethod
    def white(self) -> float:
        """Width in units of the white that surrounds each marker."""

    @cached_property
    def _expected(self) -> NDArray[np.bool_]:
        """Which cells of the check (m, (k + 2)^2) must be dark; the ring around a marker is white."""
        ringed = np.pad(self.markers.cells, ((0, 0), (1, 1), (1, 1)))
        return np.ascontiguousarray(ringed.reshape(len(self.markers.ids), -1))

    @property
    def least_markers(self) -> int:
        """Markers that must be seen."""
        return min(_LEAST_MARKERS, len(self.markers.ids))

    def seen_markers(self, image: Image, check_points_px: Array) -> NDArray[np.bool_]:
        """Which markers (m,) show all their cells, given where `check_points_m` are seen."""
        seen: NDArray[np.bool_] = np.empty(len(self.markers.ids), dtype=np.bool_)
        markers_seen(image, check_points_px, self._expected, MIN_CONTRAST_GREY, SIDE_MARGIN, seen)
        return seen

    def agrees(self, image: Image, check_points_px: Array) -> bool:
        """Tell whether enough markers show the right cells: a board that lies a square beside it does not."""
        return int(self.seen_markers(image, check_points_px).sum()) >= self.least_markers

    @cached_property
    @abstractmethod
    def kind(self) -> CornerKind:
        """What the corners look like."""

    @cached_property
    def plain_m(self) -> Array:
        """Places (k, 3) of one colour, large enough to show the noise of the pixels; none by default."""
        return np.empty((0, 3))

    def refine(self, image: Image, seeds_px: Array) -> Corners | None:
        """Refine the corners that look as they must, a second time if they show more markers than the seeds did.

        The markers that are seen tell that the board is there; a corner needs no marker beside it.
        """
        homography = plane_to_image(self.corners_m, seeds_px)
        if homography is None:
            return None
        seen = self.seen_markers(image, mapped(homography, self.check_points_m))
        corners = self._refined(image, homography, seeds_px, seen)
        if corners is None or seen.all():
            return corners
        again = plane_to_image(corners.of(self.corners_m), corners.px)
        if again is None:
            return corners
        now_seen = self.seen_markers(image, mapped(again, self.check_points_m))
        if now_seen.sum() <= seen.sum():
            return corners
        return self._refined(image, again, mapped(again, self.corners_m), now_seen)

    def _refined(self, image: Image, homography: Array, seeds_px: Array, seen: NDArray[np.bool_]) -> Corners | None:
        if seen.sum() < self.least_markers:
            return None
        corners = refine_seen_corners(image, self.corners_m, seeds_px, homography, self.kind, self.plain_m)
        return corners if corners is not None and _spread_out(corners.of(self.corners_m)) else None

    def find(self, image: Image) -> Array | None:
        """Find the board by its markers."""
        found = self._detected(image)
        if found is None:
            return None
        which, px = found
        points = self._marker_corners_m[which]
        homography, inlier = cv2.findHomography(
            points.reshape(-1, 3)[:, :2], px.reshape(-1, 2), cv2.RANSAC, _OFF_PLANE_PX
        )
        if homography is None:
            return None
        on_plane = inlier.reshape(-1, 4).all(axis=1)
        if on_plane.sum() < self.least_markers:
            return None
        refined = plane_to_image(points[on_plane].reshape(-1, 3), px[on_plane].reshape(-1, 2))
        return None if refined is None else mapped(refined, self.corners_m)

    def _detected(self, image: Image) -> tuple[NDArray[np.intp], Array] | None:
        """Indices (k,) of the markers that are read, and their corners (k, 4, 2); None if too few, or one twice."""
        quads, ids, _ = self._detector.detectMarkers(image)
        if ids is None:
            return None
        index = {int(key): k for k, key in enumerate(self.markers.ids)}
        mine = [(index[int(key)], quad[0]) for key, quad in zip(ids.ravel(), quads, strict=True) if int(key) in index]
        which = np.array([k for k, _ in mine], dtype=np.intp)
        if len(which) < self.least_markers or len(np.unique(which)) < len(which):
            return None
        return which, np.array([quad for _, quad in mine], dtype=np.float64)

    @cached_property
    def _detector(self) -> cv2.aruco.ArucoDetector:
        return cv2.aruco.ArucoDetector(dictionary_named(self.dictionary))

    @cached_property
    def _marker_corners_m(self) -> Array:
        """Corners (m, 4, 3) of the markers, clockwise from the top left."""
        left, top = self.markers.top_left.T
        right, bottom = left + self.markers.edge, top + self.markers.edge
        across, down = np.stack([left, right, right, left], axis=1), np.stack([top, top, bottom, bottom], axis=1)
        return self.at(across.ravel(), down.ravel()).reshape(-1, 4, 3)


def _spread_out(points_m: Array) -> bool:
    """Whether points (n, 3) determine a pose: at least four, not in a line."""
    if len(points_m) < LEAST_CORNERS:
        return False
    widths = np.linalg.svd(points_m[:, :2] - points_m[:, :2].mean(axis=0), compute_uv=False)
    return bool(widths[1] > _LEAST_WIDTH * widths[0])


def _merged(lines: Array) -> Array:
    """Sorted lines, those that are the same but for rounding once."""
    ordered = np.sort(lines)
    return np.asarray(ordered[np.concatenate([[True], np.diff(ordered) > 1e-9])])
