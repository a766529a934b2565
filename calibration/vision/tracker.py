"""Following the board from frame to frame: a trustworthy pose in every picture, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.vision.board import Board, find, grey
from calibration.vision.corners import Corners, sharpen, spacing
from calibration.vision.lens import Lens
from calibration.vision.pose import Pose, PosePrior, refine, solutions
from calibration.vision.transforms import RigidTransform
from runs.records import DetectionStatus

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

# More than this is not a board seen through this lens; less is not a measurement.
_WORST_PX = 0.6
_BEST_PX = 0.001
# Grey values that the corner's model leaves, in shares of the step from dark to bright.
_WORST_MISFIT = 0.15
# A flip is decided by the picture alone when its residuals are so many variances worse.
_FLIP_EVIDENCE = 16.0
_FLIP_SAME_RAD = 0.02
# Further from what the other cameras say than this, a pose is the flip of the right one.
_OTHER_SIDE_RAD = 0.1
# Followed from frame to frame, a pose whose residuals are so many times larger than the corners say is looked at anew.
_SUSPECT = 3.0


@dataclass(frozen=True)
class Detection:
    """What one picture showed: corners and pose where `seen` is MEASURED, the reason where it is not.

    Corners without a pose are those of a board that may be tilted either way.
    """

    seen: DetectionStatus
    corners: Corners | None = None
    pose: Pose | None = None


class Tracker:
    """Finds the board, then follows it by its velocity; keeps the corners' order and the side of the flip."""

    def __init__(self, board: Board, lens: Lens, known: PosePrior | None = None) -> None:
        """`known` is what holds of the board's pose before the camera in every picture."""
        self._board = board
        self._lens = lens
        self._known = known
        self._last: Pose | None = None
        self._before: Pose | None = None

    def see(self, picture: Image) -> Detection:
        """Measure the board in the next picture, (height, width) grey or (height, width, 3) BGR."""
        image = grey(picture)
        sighting = Detection(DetectionStatus.NO_BOARD)
        if self._last is not None:
            predicted = 2 * self._last.projected_px - self._before.projected_px if self._before else None
            if predicted is not None:
                sighting = self._measure(image, predicted)
            if sighting.seen is not DetectionStatus.MEASURED:
                sighting = self._measure(image, self._find_near(image, self._last.projected_px))
        if sighting.seen is not DetectionStatus.MEASURED:
            sighting = self._measure(image, find(image, self._board))
        self._before = self._last if sighting.pose is not None else None
        # After a loss the last pose still tells the side of the flip and where to look first.
        self._last = sighting.pose or self._last
        return sighting

    def agree(self, sighting: Detection, board_in_camera: RigidTransform) -> None:
        """Take the side of the flip that others know to be right; `sighting` is what `see` gave last."""
        if sighting.corners is None or (
            sighting.pose is not None and _angle(sighting.pose.rigid, board_in_camera) < _OTHER_SIDE_RAD
        ):
            return
        poses = self._solutions(sighting.corners)
        self._before = None
        self._last = min(poses, key=lambda p: _angle(p.rigid, board_in_camera), default=self._last)

    def _find_near(self, image: Image, corners: Floats) -> Floats | None:
        """Search around the last place, two squares further out."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        margin = 2.5 * spacing(corners, self._board.pattern) + 0.15 * float((high - low).max())
        x0, y0 = np.maximum(np.floor(low - margin), 0).astype(int)
        x1, y1 = np.ceil(high + margin).astype(int) + 1
        found = find(np.ascontiguousarray(image[y0:y1, x0:x1]), self._board) if x1 > x0 and y1 > y0 else None
        return None if found is None else found + np.array([x0, y0])

    def _measure(self, image: Image, seeds: Floats | None) -> Detection:
        if seeds is None:
            return Detection(DetectionStatus.NO_BOARD)
        corners = sharpen(image, seeds, self._board.pattern)
        if corners is None:
            return Detection(DetectionStatus.NO_BOARD)
        if corners.misfit.max() > _WORST_MISFIT:
            return Detection(DetectionStatus.POOR_FIT)
        pose, seen = self._pose(corners)
        if pose is None:
            return Detection(seen)
        if not _BEST_PX < pose.reprojection_px < _WORST_PX:
            return Detection(DetectionStatus.POOR_FIT)
        check = self._lens.project(self._board.check_points_m, pose.rotation_vector, pose.translation_m)
        if not self._board.colours_fit(image, check):
            return Detection(DetectionStatus.AMBIGUOUS)
        return Detection(seen, corners, pose if seen is DetectionStatus.MEASURED else None)

    def _solutions(self, corners: Corners) -> tuple[Pose, ...]:
        points = self._board.corners_m
        return solutions(points, corners.px, self._lens, corners.covariance, corners.unexplained, self._known)

    def _pose(self, corners: Corners) -> tuple[Pose | None, DetectionStatus]:
        """The best pose, and whether it is the measured one or as good as its flip."""
        points = self._board.corners_m
        if self._last is not None and self._before is not None:
            start = self._last.rotation_vector, self._last.translation_m
            pose = refine(points, corners.px, self._lens, start, corners.covariance, corners.unexplained, self._known)
            if pose is not None and pose.misfit < _SUSPECT * (corners.px.size - 6):
                return pose, DetectionStatus.MEASURED
        # At first sight, and where following may have led to the wrong side of a flip.
        poses = self._solutions(corners)
        if not poses:
            return None, DetectionStatus.POOR_FIT
        if len(poses) == 1 or _angle(poses[0].rigid, poses[1].rigid) < _FLIP_SAME_RAD:
            return poses[0], DetectionStatus.MEASURED
        best, other = poses
        # Where even the better one fits badly, the corners are worse than they say.
        scale = max(best.misfit / (best.residuals_px.size - 6), 1.0)
        if other.misfit - best.misfit > _FLIP_EVIDENCE * scale:
            return best, DetectionStatus.MEASURED
        if self._last is not None:
            last = self._last.rigid
            return min(poses, key=lambda p: _angle(p.rigid, last)), DetectionStatus.MEASURED
        return best, DetectionStatus.AMBIGUOUS


def _angle(a: RigidTransform, b: RigidTransform) -> float:
    """Angle [rad] between two orientations."""
    trace = np.sum(a.rotation * b.rotation)
    return float(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
