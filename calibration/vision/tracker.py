"""Tracks the board from frame to frame: a verified pose per picture, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.images import Image
from calibration.vision.board import Board, grey
from calibration.vision.corners import Corners
from calibration.vision.lens import Lens
from calibration.vision.marker_board import LEAST_CORNERS
from calibration.vision.planar_motion import PlaneOfMotion
from calibration.vision.pose import Pose, refine, solutions
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from runs.records import DetectionStatus

# Accepted range of the reprojection rms: above, the board or lens is wrong; below, the fit is degenerate.
_MAX_RMS_PX = 0.6
_MIN_RMS_PX = 0.001
# Largest residual of the corner model, as a fraction of the step from dark to bright.
_MAX_MISFIT = 0.15
# Difference of the sums of squares at which one picture resolves the planar pose ambiguity (flip).
_FLIP_EVIDENCE = 16.0
_FLIP_SAME_RAD = 0.02
# Largest angle to the pose of the other cameras; above, the pose is the wrong side of the flip.
_MAX_DISAGREEMENT_RAD = 0.1
# Largest ratio of residuals to stated noise for a tracked pose; above, both sides of the flip are tried again.
_MAX_CHI2_RATIO = 3.0
# Of a board that may be partly hidden, corners whose squared residual is so many times the usual one are not the
# board's: something else crosses there. A pose needs so many of the others.
_OUTLYING = 14.0
_MEDIAN_CHI2_2 = 1.386


@dataclass(frozen=True)
class Detection:
    """Result for one picture: corners and pose if `status` is MEASURED.

    Corners without a pose: the side of the flip is ambiguous.
    """

    status: DetectionStatus
    corners: Corners | None = None
    pose: Pose | None = None


class BoardTracker:
    """Finds the board, then tracks it with constant velocity; keeps corner order and side of the flip."""

    def __init__(self, board: Board, lens: Lens, known: PlaneOfMotion | None = None) -> None:
        """`known` is a prior on the pose of the board in the camera frame, for every picture."""
        self._board = board
        self._lens = lens
        self._known = known
        self._last: Pose | None = None
        self._before: Pose | None = None

    def detect(self, picture: Image) -> Detection:
        """Measure the board in the next picture, (height, width) grey or (height, width, 3) BGR."""
        image = grey(picture)
        detection = Detection(DetectionStatus.NO_BOARD)
        if self._last is not None:
            predicted = 2 * self._every_corner(self._last) - self._every_corner(self._before) if self._before else None
            if predicted is not None:
                detection = self._measure(image, predicted)
            if detection.status is not DetectionStatus.MEASURED:
                detection = self._measure(image, self._find_near(image, self._every_corner(self._last)))
        if detection.status is not DetectionStatus.MEASURED:
            detection = self._measure(image, self._board.find(image))
        self._before = self._last if detection.pose is not None else None
        # After a loss the last pose still gives the side of the flip and the first search region.
        self._last = detection.pose or self._last
        return detection

    def correct_flip(self, detection: Detection, board_in_camera: RigidTransform) -> None:
        """Set the side of the flip by the pose of other cameras; `detection` is the last result of `detect`."""
        if detection.corners is None or (
            detection.pose is not None and _angle(detection.pose.rigid, board_in_camera) < _MAX_DISAGREEMENT_RAD
        ):
            return
        poses = self._solutions(detection.corners)
        self._before = None
        self._last = min(poses, key=lambda p: _angle(p.rigid, board_in_camera), default=self._last)

    def _find_near(self, image: Image, corners: Array) -> Array | None:
        """Search around the last position with a margin of two squares."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        margin = 2.5 * self._board.spacing(corners) + 0.15 * float((high - low).max())
        x0, y0 = np.maximum(np.floor(low - margin), 0).astype(int)
        x1, y1 = np.ceil(high + margin).astype(int) + 1
        found = self._board.find(np.ascontiguousarray(image[y0:y1, x0:x1])) if x1 > x0 and y1 > y0 else None
        return None if found is None else found + np.array([x0, y0])

    def _every_corner(self, pose: Pose) -> Array:
        """All corners (n, 2) [px] of the board at a pose, also those that were not seen."""
        points = self._board.corners_m
        if len(pose.projected_px) == len(points):
            return pose.projected_px
        return self._lens.project(points, pose.rotation_vector, pose.translation_m)

    def _measure(self, image: Image, seeds: Array | None) -> Detection:
        if seeds is None:
            return Detection(DetectionStatus.NO_BOARD)
        corners = self._board.refine(image, seeds)
        if corners is None:
            return Detection(DetectionStatus.NO_BOARD)
        if corners.misfit.max() > _MAX_MISFIT:
            return Detection(DetectionStatus.POOR_FIT)
        pose, status = self._pose(corners)
        if pose is not None and corners.seen is not None:
            kept = _consistent(corners, pose)
            if not kept.all():
                corners = corners.keeping(kept)
                pose, status = self._pose(corners) if len(corners.px) >= LEAST_CORNERS else (None, status)
        if pose is None:
            return Detection(status)
        if not _MIN_RMS_PX < pose.reprojection_px < _MAX_RMS_PX:
            return Detection(DetectionStatus.POOR_FIT)
        check = self._lens.project(self._board.check_points_m, pose.rotation_vector, pose.translation_m)
        if not self._board.agrees(image, check):
            return Detection(DetectionStatus.AMBIGUOUS)
        return Detection(status, corners, pose if status is DetectionStatus.MEASURED else None)

    def _solutions(self, corners: Corners) -> tuple[Pose, ...]:
        points = corners.of(self._board.corners_m)
        return solutions(points, corners.px, self._lens, corners.covariance, corners.unexplained, self._known)

    def _pose(self, corners: Corners) -> tuple[Pose | None, DetectionStatus]:
        """The best pose, and MEASURED, or AMBIGUOUS if its flip fits as well."""
        points = corners.of(self._board.corners_m)
        if self._last is not None and self._before is not None:
            start = self._last.rotation_vector, self._last.translation_m
            pose = refine(points, corners.px, self._lens, start, corners.covariance, corners.unexplained, self._known)
            if pose is not None and pose.misfit < _MAX_CHI2_RATIO * (corners.px.size - 6):
                return pose, DetectionStatus.MEASURED
        # In the first picture, or if tracking may have reached the wrong side of the flip.
        poses = self._solutions(corners)
        if not poses:
            return None, DetectionStatus.POOR_FIT
        if len(poses) == 1 or _angle(poses[0].rigid, poses[1].rigid) < _FLIP_SAME_RAD:
            return poses[0], DetectionStatus.MEASURED
        best, other = poses
        # If even the better pose fits badly, the stated corner noise is too small.
        scale = max(best.misfit / (best.residuals_px.size - 6), 1.0)
        if other.misfit - best.misfit > _FLIP_EVIDENCE * scale:
            return best, DetectionStatus.MEASURED
        if self._last is not None:
            last = self._last.rigid
            return min(poses, key=lambda p: _angle(p.rigid, last)), DetectionStatus.MEASURED
        return best, DetectionStatus.AMBIGUOUS


def _consistent(corners: Corners, pose: Pose) -> NDArray[np.bool_]:
    """Which corners (n,) agree with a pose that was fitted to all of them."""
    solved = np.linalg.solve(corners.covariance, pose.residuals_px[:, :, None])[:, :, 0]
    squares = np.sum(pose.residuals_px * solved, axis=1)
    return np.asarray(squares <= _OUTLYING * max(1.0, float(np.median(squares)) / _MEDIAN_CHI2_2))


def _angle(a: RigidTransform, b: RigidTransform) -> float:
    """Angle [rad] between two orientations."""
    trace = np.sum(a.rotation * b.rotation)
    return float(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
