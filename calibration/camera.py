"""Intrinsics and distortion of a camera from views of a board."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calibration.corner_search import SeenCorners, no_board, seen_corners, with_exposure
from calibration.intrinsics_covariance import intrinsics_covariance
from calibration.view_coverage import ViewCoverage, view_geometry
from calibration.views import View, views_in
from calibration.vision.board import Board
from calibration.vision.lens import Lens
from model.arrays import Array

_CONVERGED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)
_LEAST_VIEWS = 4
# Corners that a view needs: four fix its pose, and the others say something of the lens.
_LEAST_CORNERS = 6
# Outlier threshold of a view's rms relative to the median: a wrong corner, or a moved board.
_OUTLYING = 3.0
# More than this is not noise of pixels: a bent board, a moved one, or another kind of lens.
_LARGE_PX = 1.0

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


class CalibrationError(Exception):
    """The views do not determine the camera; the message states what is missing."""


class ExcludedView(NamedTuple):
    """A view that was not used, and why."""

    name: str
    reason: str
    sha256: str


@dataclass(frozen=True)
class CalibratedView:
    """One view that was used: the corners seen and their `residuals_px` (n, 2), measured minus projected."""

    name: str
    sha256: str
    corners: SeenCorners
    residuals_px: Array
    rotation_vector: Array
    translation_m: Array

    @property
    def rms_px(self) -> float:
        """Root mean square distance between measured and projected corners."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px**2, axis=1))))


@dataclass(frozen=True)
class CameraCalibration:
    """A camera's intrinsics: `parameters` (9,) in order of PARAMETERS and their `covariance` (9, 9).

    `skipped` says of every view that was not used why it was not.
    """

    width_px: int
    height_px: int
    board: Board
    parameters: Array
    covariance: Array
    rms_px: float
    views: tuple[CalibratedView, ...]
    skipped: tuple[ExcludedView, ...]

    @property
    def std(self) -> Array:
        """Standard uncertainties (9,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def lens(self) -> Lens:
        """The lens."""
        fx, fy, cx, cy, *distortion = (float(p) for p in self.parameters)
        return Lens.of(fx, fy, cx, cy, tuple(distortion))

    @property
    def coverage(self) -> ViewCoverage:
        """Coverage of picture, tilt and distance by the views."""
        size, lens = (self.width_px, self.height_px), self.lens
        return ViewCoverage(size, [view_geometry(self.board, v.corners, size, lens) for v in self.views])

    @property
    def advice(self) -> tuple[str, ...]:
        """Advice for a better calibration; empty if it is good enough."""
        wants = self.coverage.advice()
        if self.rms_px > _LARGE_PX:
            wants += (f"the residuals are large ({self.rms_px:.2f} px): is the board flat, and the lens no fisheye?",)
        return wants


def calibrate(source: Path, board: Board, every: int = 1) -> CameraCalibration:
    """Calibrate from a folder of pictures or a video (every `every`-th frame).

    Raises:
        ViewsError: the source holds no picture.
        CalibrationError: too few views show the board, or they differ in size.
    """
    return calibrate_views(views_in(source, every), board)


def calibrate_views(views: Iterable[View], board: Board) -> CameraCalibration:
    """Calibrate from pictures; see `calibrate`."""
    if not board.unit_m > 0:
        raise CalibrationError(f"a {board.description} with an edge of {board.unit_m} m has no size")
    if len(board.corners_m) < _LEAST_CORNERS or not np.ptp(board.corners_m[:, :2], axis=0).min() > 0:
        raise CalibrationError(f"a {board.description} is too small to calibrate with")
    found: list[tuple[View, SeenCorners]] = []
    skipped: list[ExcludedView] = []
    size: tuple[int, int] | None = None
    for view in views:
        height, width = view.image.shape
        if size is not None and size != (width, height):
            raise CalibrationError(f"{view.name} is {width}x{height} and the views before it {size[0]}x{size[1]}")
        size = (width, height)
        seen = seen_corners(board, view.image)
        if seen is None:
            skipped.append(ExcludedView(view.name, no_board(view.image, board), view.sha256))
        elif len(seen.which) < _LEAST_CORNERS:
            reason = f"{len(seen.which)} corners of the board seen, at least {_LEAST_CORNERS} are needed"
            skipped.append(ExcludedView(view.name, with_exposure(reason, view.image), view.sha256))
        else:
            found.append((view, seen))
    if size is None or len(found) < _LEAST_VIEWS:
        raise CalibrationError(
            f"{len(found)} of {len(found) + len(skipped)} views show a {board.description}, at least {_LEAST_VIEWS} "
            f"are needed: {board.remedy}, and light the board evenly"
        )
    result = _solve(found, size, board, skipped)
    # Remove one outlier at a time, because the worst view also raises the residuals of the others.
    while len(result.views) > _LEAST_VIEWS:
        usual = float(np.median([v.rms_px for v in result.views]))
        worst = max(range(len(found)), key=lambda k: result.views[k].rms_px)
        if result.views[worst].rms_px <= _OUTLYING * usual:
            break
        view, _ = found.pop(worst)
        why = f"residual {result.views[worst].rms_px:.2f} px where the median is {usual:.2f} px"
        skipped.append(ExcludedView(view.name, with_exposure(why, view.image), view.sha256))
        result = _solve(found, size, board, skipped)
    return result


def _solve(
    found: list[tuple[View, SeenCorners]],
    size: tuple[int, int],
    board: Board,
    skipped: list[ExcludedView],
) -> CameraCalibration:
    points = [board.corners_m[seen.which].astype(np.float32) for _, seen in found]
    pixels = [seen.px.astype(np.float32).reshape(-1, 1, 2) for _, seen in found]
    rms, matrix, distortion, rotations, translations = cv2.calibrateCamera(
        points, pixels, size, np.eye(3), np.zeros(5), criteria=_CONVERGED
    )
    lens = Lens(np.asarray(matrix, dtype=np.float64), np.asarray(distortion, dtype=np.float64).ravel()[:5])
    used = []
    for (view, seen), rotation, translation in zip(found, rotations, translations, strict=True):
        vector, offset = np.asarray(rotation, np.float64).ravel(), np.asarray(translation, np.float64).ravel()
        residuals = seen.px - lens.project(board.corners_m[seen.which], vector, offset)
        used.append(CalibratedView(view.name, view.sha256, seen, residuals, vector, offset))
    m = lens.matrix
    parameters = np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], lens.distortion])
    slopes = [_slopes(board.corners_m[view.corners.which], lens, view) for view in used]
    covariance = intrinsics_covariance(slopes, [view.residuals_px.ravel() for view in used])
    return CameraCalibration(*size, board, parameters, covariance, float(rms), tuple(used), tuple(skipped))


def _slopes(points_m: Array, lens: Lens, view: CalibratedView) -> tuple[Array, Array]:
    """Derivatives of the corner coordinates of a view by its pose (2 n, 6) and by the intrinsics (2 n, 9)."""
    _, jacobian = cv2.projectPoints(points_m, view.rotation_vector, view.translation_m, lens.matrix, lens.distortion)
    slope = np.asarray(jacobian, dtype=np.float64)
    return slope[:, :6], slope[:, 6 : 6 + len(PARAMETERS)]
