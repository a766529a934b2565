"""A drawn picture of a board, measured once before a run: what no picture has needed yet is compiled then.

Without it, a board that comes into view during the first run of a new version finds its kernels not compiled, and the
observer measures nothing for seconds.
"""

from __future__ import annotations

import cv2
import numpy as np

from calibration.images import Image
from calibration.vision.board import Board
from calibration.vision.lens import Lens
from calibration.vision.planar_motion import PlaneOfMotion
from calibration.vision.tracker import BoardTracker
from runs.records import DetectionStatus

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 640, 480, 600.0
LENS = Lens.of(FOCAL_PX, FOCAL_PX, WIDTH_PX / 2, HEIGHT_PX / 2)
_TILT_RAD = (0.5, 0.35)
_SHARE = 0.6
"""Of the picture's height that the print takes."""
_FINER, _SHIFT = 4, 4
_DARK, _WHITE, _NOISE_GREY = 40, 210, 2.0


def warm_up(board: Board, known: PlaneOfMotion | None = None) -> DetectionStatus:
    """Find, follow, lose and find a board anew in drawn pictures; the status of the last one."""
    trackers = [BoardTracker(board, LENS)] + ([BoardTracker(board, LENS, known)] if known is not None else [])
    nothing = np.full((HEIGHT_PX, WIDTH_PX), _WHITE, np.uint8)
    pictures = [drawn(board, 0.0), drawn(board, 0.01), drawn(board, 0.02), nothing, drawn(board, 0.02)]
    statuses = [[tracker.detect(picture).status for picture in pictures] for tracker in trackers]
    return statuses[0][-1]


def drawn(board: Board, turn_rad: float) -> Image:
    """The tilted board in the middle of a picture of a camera with the lens LENS."""
    printed, extent_m = board.printed, max(board.extent) * board.unit_m
    facing, tilt = (cv2.Rodrigues(np.array(v))[0] for v in ((np.pi, 0.0, 0.0), (*_TILT_RAD, turn_rad)))
    vector = np.asarray(cv2.Rodrigues(facing @ tilt)[0], np.float64).ravel()
    away_m = np.array([0.0, 0.0, FOCAL_PX * extent_m / (_SHARE * HEIGHT_PX)])
    across, down = np.meshgrid(printed.across, printed.down)
    corners = LENS.project(board.at(across.ravel(), down.ravel()), vector, away_m).reshape(*across.shape, 2)
    fine = np.full((_FINER * HEIGHT_PX, _FINER * WIDTH_PX), _WHITE, np.uint8)
    for row, column in np.argwhere(printed.dark):
        cell = corners[[row, row, row + 1, row + 1], [column, column + 1, column + 1, column]]
        # The middle of a pixel is its coordinate: the finer pixels lie around it.
        places = np.round(((cell + 0.5) * _FINER - 0.5) * 2**_SHIFT).astype(np.int32)
        cv2.fillConvexPoly(fine, places, (_DARK,), cv2.LINE_8, _SHIFT)
    picture = cv2.resize(fine, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA).astype(np.float64)
    noise = np.random.default_rng(0).normal(0.0, _NOISE_GREY, picture.shape)
    return np.asarray(np.clip(cv2.GaussianBlur(picture, (0, 0), 0.7) + noise, 0, 255), np.uint8)
