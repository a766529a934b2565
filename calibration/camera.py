"""Intrinsics and distortion of a camera from views of a checkerboard."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.corners import sharpen, spacing
from calibration.lens import Lens
from calibration.views import View, views_in

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

_FLAGS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_SUBPIX = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
_CONVERGED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)
_LEAST_VIEWS = 4
# A view whose rms is so many times the median's shows a corner that was mistaken, or a board that moved.
_OUTLYING = 3.0
# Where the board should have been seen: cells of the picture, and tilts.
_CELLS = (4, 3)
_ENOUGH_CELLS = 0.75
_ENOUGH_TILT_DEG = 20.0
_ENOUGH_VIEWS = 10

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


class CalibrationError(Exception):
    """The views do not determine the camera; the message says what is missing."""


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

    @property
    def tilt_deg(self) -> float:
        """Angle between the board's normal and the line of sight."""
        rotation, _ = cv2.Rodrigues(self.rotation_vector)
        sight = self.translation_m / np.linalg.norm(self.translation_m)
        return float(np.degrees(np.arccos(np.clip(abs(rotation[:, 2] @ sight), 0, 1))))


@dataclass(frozen=True)
class CameraCalibration:
    """A camera's intrinsics: `parameters` and their standard uncertainties `std`, both (9,) in order of PARAMETERS.

    `skipped` says of every view that was not used why it was not.
    """

    width_px: int
    height_px: int
    corners: tuple[int, int]
    square_m: float
    parameters: Floats
    std: Floats
    rms_px: float
    views: tuple[CalibratedView, ...]
    skipped: tuple[tuple[str, str], ...]

    @property
    def lens(self) -> Lens:
        """The lens."""
        fx, fy, cx, cy, *distortion = (float(p) for p in self.parameters)
        return Lens.of(fx, fy, cx, cy, tuple(distortion))

    @property
    def coverage(self) -> float:
        """Share of the picture's cells in which some corner was seen."""
        corners = np.concatenate([v.corners_px for v in self.views])
        cells = np.floor(corners / (self.width_px, self.height_px) * _CELLS).astype(int)
        return len({tuple(c) for c in cells.tolist()}) / (_CELLS[0] * _CELLS[1])

    @property
    def advice(self) -> tuple[str, ...]:
        """What more views would help, in plain words; empty when these are enough."""
        wants = []
        if len(self.views) < _ENOUGH_VIEWS:
            wants.append(f"take at least {_ENOUGH_VIEWS} views; {len(self.views)} could be used")
        if self.coverage < _ENOUGH_CELLS:
            wants.append(
                f"show the board near the edges and corners too: it covered {self.coverage:.0%} of the picture"
            )
        tilt = max(v.tilt_deg for v in self.views)
        if tilt < _ENOUGH_TILT_DEG:
            wants.append(f"tilt the board by 20 to 45 deg: the largest tilt was {tilt:.0f} deg, so f is uncertain")
        return tuple(wants)


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
    skipped: list[tuple[str, str]] = []
    size: tuple[int, int] | None = None
    for view in views:
        height, width = view.image.shape
        if size is not None and size != (width, height):
            raise CalibrationError(f"{view.name} is {width}x{height} and the views before it {size[0]}x{size[1]}")
        size = (width, height)
        seen = find_corners(view.image, corners)
        if seen is None:
            skipped.append((view.name, f"no board of {corners[0]}x{corners[1]} inner corners found"))
        else:
            found.append((view, seen))
    if size is None or len(found) < _LEAST_VIEWS:
        raise CalibrationError(
            f"{len(found)} of {len(found) + len(skipped)} views show a board of {corners[0]}x{corners[1]} inner "
            f"corners, at least {_LEAST_VIEWS} are needed: count the inner corners, not the squares, and light the "
            "board evenly"
        )
    result = _solve(found, size, corners, square_m, skipped)
    usual = float(np.median([v.rms_px for v in result.views]))
    bad = {v.name: v.rms_px for v in result.views if v.rms_px > _OUTLYING * usual}
    if bad and len(found) - len(bad) >= _LEAST_VIEWS:
        skipped += [(n, f"residual {r:.2f} px where the median is {usual:.2f} px") for n, r in bad.items()]
        result = _solve([f for f in found if f[0].name not in bad], size, corners, square_m, skipped)
    return result


def find_corners(image: Image, corners: tuple[int, int]) -> Floats | None:
    """Corners (n, 2) of any checkerboard in a grey picture, to sub-pixel; which end comes first is left open."""
    found, raw = cv2.findChessboardCorners(image, corners, flags=_FLAGS)
    if not found:
        found, raw = cv2.findChessboardCornersSB(image, corners, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    seeds = np.asarray(raw, dtype=np.float64).reshape(-1, 2)
    sharp = sharpen(image, seeds, corners)
    if sharp is not None:
        return sharp.px
    half = max(2, int(0.4 * spacing(seeds, corners)))
    refined = cv2.cornerSubPix(image, seeds.astype(np.float32).reshape(-1, 1, 2), (half, half), (-1, -1), _SUBPIX)
    return np.asarray(refined[:, 0, :], dtype=np.float64)


def _solve(
    found: list[tuple[View, Floats]],
    size: tuple[int, int],
    corners: tuple[int, int],
    square_m: float,
    skipped: list[tuple[str, str]],
) -> CameraCalibration:
    grid = np.zeros((corners[0] * corners[1], 3), np.float32)
    grid[:, :2] = np.indices(corners).T.reshape(-1, 2) * square_m
    points = [c.astype(np.float32).reshape(-1, 1, 2) for _, c in found]
    rms, matrix, distortion, rotations, translations, std, _, _ = cv2.calibrateCameraExtended(
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
    spread = np.asarray(std, dtype=np.float64).ravel()[:9]
    return CameraCalibration(*size, corners, square_m, parameters, spread, float(rms), tuple(used), tuple(skipped))
