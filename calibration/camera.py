"""Intrinsics and distortion of a camera from views of a checkerboard."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics_covariance import intrinsics_covariance
from calibration.view_coverage import ViewCoverage, view_geometry
from calibration.views import View, views_in
from calibration.vision.corners import sharpen, spacing
from calibration.vision.exposure import exposure_fault
from calibration.vision.lens import Lens

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SUBPIX = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
_CONVERGED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)
_LEAST_VIEWS = 4
# Outlier threshold of a view's rms relative to the median: a wrong corner, or a moved board.
_OUTLYING = 3.0
# Boards are sought in pictures of at most this width: corners need no more, and they are sharpened in the whole one.
_WIDTH_PX = 1000
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
    """One view that was used: `corners_px` and `residuals_px` (n, 2), measured minus projected."""

    name: str
    sha256: str
    corners_px: Floats
    residuals_px: Floats
    rotation_vector: Floats
    translation_m: Floats

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
    corners: tuple[int, int]
    square_m: float
    parameters: Floats
    covariance: Floats
    rms_px: float
    views: tuple[CalibratedView, ...]
    skipped: tuple[ExcludedView, ...]

    @property
    def std(self) -> Floats:
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
        return ViewCoverage(size, [view_geometry(v.corners_px, self.corners, size, lens) for v in self.views])

    @property
    def advice(self) -> tuple[str, ...]:
        """Advice for a better calibration; empty if it is good enough."""
        wants = self.coverage.advice()
        if self.rms_px > _LARGE_PX:
            wants += (f"the residuals are large ({self.rms_px:.2f} px): is the board flat, and the lens no fisheye?",)
        return wants


def calibrate(source: Path, corners: tuple[int, int], square_m: float, every: int = 1) -> CameraCalibration:
    """Calibrate from a folder of pictures or a video (every so many frames); `corners` are the board's inner corners.

    Raises:
        ViewsError: the source holds no picture.
        CalibrationError: too few views show the board, or they differ in size.
    """
    return calibrate_views(views_in(source, every), corners, square_m)


def calibrate_views(views: Iterable[View], corners: tuple[int, int], square_m: float) -> CameraCalibration:
    """Calibrate from pictures; see `calibrate`."""
    if min(corners) < 2 or max(corners) < 3:
        raise CalibrationError(f"a board of {corners[0]}x{corners[1]} inner corners is too small to calibrate with")
    if not square_m > 0:
        raise CalibrationError(f"a square of {square_m} m has no size")
    found: list[tuple[View, Floats]] = []
    skipped: list[ExcludedView] = []
    size: tuple[int, int] | None = None
    for view in views:
        height, width = view.image.shape
        if size is not None and size != (width, height):
            raise CalibrationError(f"{view.name} is {width}x{height} and the views before it {size[0]}x{size[1]}")
        size = (width, height)
        seen = find_corners(view.image, corners)
        if seen is None:
            skipped.append(ExcludedView(view.name, no_board(view.image, corners), view.sha256))
        else:
            found.append((view, seen))
    if size is None or len(found) < _LEAST_VIEWS:
        raise CalibrationError(
            f"{len(found)} of {len(found) + len(skipped)} views show a board of {corners[0]}x{corners[1]} inner "
            f"corners, at least {_LEAST_VIEWS} are needed: count the inner corners, not the squares, and light the "
            "board evenly"
        )
    result = _solve(found, size, corners, square_m, skipped)
    # Remove one outlier at a time, because the worst view also raises the residuals of the others.
    while len(result.views) > _LEAST_VIEWS:
        usual = float(np.median([v.rms_px for v in result.views]))
        worst = max(range(len(found)), key=lambda k: result.views[k].rms_px)
        if result.views[worst].rms_px <= _OUTLYING * usual:
            break
        view, _ = found.pop(worst)
        why = f"residual {result.views[worst].rms_px:.2f} px where the median is {usual:.2f} px"
        skipped.append(ExcludedView(view.name, _with_exposure(why, view.image), view.sha256))
        result = _solve(found, size, corners, square_m, skipped)
    return result


def find_corners(image: Image, corners: tuple[int, int]) -> Floats | None:
    """Corners (n, 2) of any checkerboard in a grey picture, to sub-pixel, in rows as seen from the print's front.

    The colours determine which end comes first where one count is odd and the other even, the first square between
    corners being the dark one; on other boards it is left open.
    """
    seeds = _seeds(image, corners)
    if seeds is None:
        return None
    sharp = sharpen(image, seeds, corners)
    if sharp is not None:
        return sharp.px
    half = max(2, int(0.4 * spacing(seeds, corners)))
    refined = cv2.cornerSubPix(image, seeds.astype(np.float32).reshape(-1, 1, 2), (half, half), (-1, -1), _SUBPIX)
    return np.asarray(refined[:, 0, :], dtype=np.float64)


def no_board(image: Image, corners: tuple[int, int]) -> str:
    """Return the reason for a grey picture in which no board was found."""
    return _with_exposure(f"no board of {corners[0]}x{corners[1]} inner corners found", image)


def _with_exposure(reason: str, image: Image) -> str:
    """Return the reason, followed by the exposure fault of the picture if it has one."""
    return f"{reason}; {fault}" if (fault := exposure_fault(image)) else reason


def _seeds(image: Image, corners: tuple[int, int]) -> Floats | None:
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


def _in_order(image: Image, grid: Floats) -> Floats:
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


def _solve(
    found: list[tuple[View, Floats]],
    size: tuple[int, int],
    corners: tuple[int, int],
    square_m: float,
    skipped: list[ExcludedView],
) -> CameraCalibration:
    grid = np.zeros((corners[0] * corners[1], 3), np.float32)
    grid[:, :2] = np.indices(corners).T.reshape(-1, 2) * square_m
    points = [c.astype(np.float32).reshape(-1, 1, 2) for _, c in found]
    rms, matrix, distortion, rotations, translations = cv2.calibrateCamera(
        [grid] * len(found), points, size, np.eye(3), np.zeros(5), criteria=_CONVERGED
    )
    lens = Lens(np.asarray(matrix, dtype=np.float64), np.asarray(distortion, dtype=np.float64).ravel()[:5])
    used = []
    for (view, seen), rotation, translation in zip(found, rotations, translations, strict=True):
        vector, offset = np.asarray(rotation, np.float64).ravel(), np.asarray(translation, np.float64).ravel()
        residuals = seen - lens.project(grid.astype(np.float64), vector, offset)
        used.append(CalibratedView(view.name, view.sha256, seen, residuals, vector, offset))
    m = lens.matrix
    parameters = np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], lens.distortion])
    slopes = [_slopes(grid.astype(np.float64), lens, view) for view in used]
    covariance = intrinsics_covariance(slopes, [view.residuals_px.ravel() for view in used])
    return CameraCalibration(*size, corners, square_m, parameters, covariance, float(rms), tuple(used), tuple(skipped))


def _slopes(grid: Floats, lens: Lens, view: CalibratedView) -> tuple[Floats, Floats]:
    """Derivatives of the corner coordinates of a view by its pose (2 n, 6) and by the intrinsics (2 n, 9)."""
    _, jacobian = cv2.projectPoints(grid, view.rotation_vector, view.translation_m, lens.matrix, lens.distortion)
    slope = np.asarray(jacobian, dtype=np.float64)
    return slope[:, :6], slope[:, 6 : 6 + len(PARAMETERS)]
