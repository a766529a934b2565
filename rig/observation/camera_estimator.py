"""Tip estimator of one camera or several: simultaneous pictures in, the tip from all that see the board out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.dlt import DLT, DLTError
from calibration.multiview_pose import board_pose
from calibration.vision.corners import Corners
from calibration.vision.pose import tip_in_base
from calibration.vision.tracker import BoardTracker, Detection
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.config.optics import board_in_tip, board_of, camera_in_base, lens_of, plane_of
from rig.config.schema import RigConfig
from rig.hardware.cameras.base import Frame, FrameSet
from rig.observation.tip_measurement import TipMeasurement
from runs.records import DetectionStatus

_SAMPLED_ROWS = 16
"""Row step for the comparison with the previous picture; sensor noise never repeats exactly."""
# Exposures closer than this count as simultaneous.
_SIMULTANEOUS_NS = 100_000
# Speeds are estimated from pictures at most _RECENT_PERIODS apart. Relative error of the speed of one camera:
# _SPEED_SHARE; of the corners: _CHANGE_SHARE of their largest change between the last pictures.
_RECENT_PERIODS = 4.5
_SPEED_SHARE = 0.3
_CHANGE_SHARE = 1.0
# Residuals of all cameras together beyond this, and beyond the uncertainty of their placements, contradict each other.
_WORST_PX = 0.6
_PLACEMENT_STDS = 3.0
# Corners of a partly hidden board that must have been seen before, to be moved to the time of another camera.
_LEAST_CORNERS = 4


@dataclass(frozen=True)
class _PreviousEstimate:
    """Previous position: corners [px] or the tip [m]; its speed [1/ns] and the change of the speed."""

    t_ns: int
    place: Array
    speed: Array | None = None
    change: Array | None = None


class CameraTipEstimator:
    """Measures the tip in the rig's frame sets, in order.

    Two or more pictures with the board give one pose in the world (`calibration.multiview_pose`). Where only
    one camera sees the board, that camera alone measures the tip.
    """

    def __init__(self, config: RigConfig) -> None:
        cameras, board = tuple(config.cameras.values()), board_of(config)
        self._trackers = [BoardTracker(board, lens_of(camera), plane_of(config, camera)) for camera in cameras]
        self._previous_rows: list[NDArray[np.uint8] | None] = [None] * len(cameras)
        self._previous_corners: list[_PreviousEstimate | None] = [None] * len(cameras)
        self._previous_tip: _PreviousEstimate | None = None
        self._recent_ns = _RECENT_PERIODS * max(1e9 / camera.rate_hz for camera in cameras)
        self._points_m = board.corners_m
        self._board_in_tip = board_in_tip(config)
        # The world origin is the straight arm's tip, which is in front of every camera that sees the board.
        self._world_in_base = RigidTransform(np.eye(3), np.array([0.0, 0.0, config.arm.length_mm * 1e-3]))
        self._cameras_in_base = [camera_in_base(camera) for camera in cameras]
        self._cameras_in_world = [self._in_world(camera) for camera in self._cameras_in_base]
        self._dlts = (
            [DLT.of_camera(lens_of(c), p) for c, p in zip(cameras, self._cameras_in_world, strict=True)]
            if len(cameras) > 1
            else []
        )

    def measure(self, frame_set: FrameSet) -> TipMeasurement:
        """Measure the tip in the next frame set, at the time of its leading frame."""
        detections = [self._detect(k, frame) for k, frame in enumerate(frame_set.frames)]
        found = self._measure_jointly(frame_set, detections) or self._measure_alone(frame_set, detections)
        if found.seen is DetectionStatus.MEASURED:
            self._previous_tip = _PreviousEstimate(frame_set.t_ns, found.tip_m)
        leading = detections[frame_set.leader].corners
        count = len(self._points_m)
        leading_px = leading.padded(count) if found.seen is DetectionStatus.MEASURED and leading is not None else None
        board = tuple(None if d.corners is None else d.corners.padded(count) for d in detections)
        return replace(found, corners_px=leading_px, board_px=board)

    def _detect(self, k: int, frame: Frame | None) -> Detection:
        """Detect the board in camera `k`; a repeated picture counts as no frame, because the camera is frozen."""
        if frame is None:
            return Detection(DetectionStatus.NO_FRAME)
        before, sampled_rows = self._previous_rows[k], frame.image[::_SAMPLED_ROWS].copy()
        self._previous_rows[k] = sampled_rows
        # A uniformly black or white picture has no noise to compare.
        if before is not None and np.array_equal(before, sampled_rows) and before.min() != before.max():
            return Detection(DetectionStatus.NO_FRAME)
        return self._trackers[k].detect(frame.image)

    def _measure_jointly(self, frame_set: FrameSet, detections: Sequence[Detection]) -> TipMeasurement | None:
        """Measure the tip from all cameras that see the board; None with fewer than two."""
        corners = {
            k: moved
            for k, (frame, detection) in enumerate(zip(frame_set.frames, detections, strict=True))
            if frame is not None and (moved := self._corners_at(frame_set.t_ns, k, frame.t_ns, detection)) is not None
        }
        if len(corners) < 2:
            return None
        cameras = [self._dlts[k] for k in corners]
        try:
            pose = board_pose(self._points_m, cameras, list(corners.values()))
        except (DLTError, np.linalg.LinAlgError):
            pose = None
        seen = tuple(
            DetectionStatus.MEASURED if k in corners else _unused(detection.status)
            for k, detection in enumerate(detections)
        )
        allowed = _WORST_PX + _PLACEMENT_STDS * max(self._placement_std_px(camera) for camera in cameras)
        if pose is None or pose.reprojection_px > allowed:
            statuses = tuple(DetectionStatus.DISAGREE if s is DetectionStatus.MEASURED else s for s in seen)
            return TipMeasurement.none(DetectionStatus.DISAGREE, statuses)
        for k in corners:
            self._trackers[k].correct_flip(detections[k], self._cameras_in_world[k].inverse() @ pose.rigid)
        tip, covariance = tip_in_base(pose, self._board_in_tip, self._world_in_base)
        return TipMeasurement(
            DetectionStatus.MEASURED, tip.translation_m, tip.rotation, covariance, pose.reprojection_px, None, seen
        )

    def _measure_alone(self, frame_set: FrameSet, detections: Sequence[Detection]) -> TipMeasurement:
        """Measure the tip from the first camera that can do so alone."""
        seen = tuple(detection.status for detection in detections)
        if DetectionStatus.MEASURED not in seen:
            reason = next((s for s in seen if s is not DetectionStatus.NO_FRAME), DetectionStatus.NO_FRAME)
            return TipMeasurement.none(reason, seen)
        k = seen.index(DetectionStatus.MEASURED)
        frame, pose, corners = frame_set.frames[k], detections[k].pose, detections[k].corners
        assert frame is not None
        assert pose is not None
        assert corners is not None
        tip, covariance = tip_in_base(pose, self._board_in_tip, self._cameras_in_base[k])
        cameras = tuple(s if j == k else _unused(s) for j, s in enumerate(seen))
        skew_ns = frame.t_ns - frame_set.t_ns
        found = TipMeasurement(
            seen[k], tip.translation_m, tip.rotation, covariance, pose.reprojection_px, corners.px, cameras
        )
        return found if abs(skew_ns) <= _SIMULTANEOUS_NS else self._extrapolated(found, frame.t_ns, skew_ns)

    def _extrapolated(self, found: TipMeasurement, t_ns: int, skew_ns: int) -> TipMeasurement:
        """Extrapolate a tip over a camera skew; its orientation, whose speed is unknown, is left out."""
        displacement_m = self._velocity(t_ns, found.tip_m) * skew_ns
        covariance = np.full((6, 6), np.nan)
        error_m = _SPEED_SHARE * displacement_m
        covariance[:3, :3] = found.covariance_m2 + np.outer(error_m, error_m)
        return replace(
            found, tip_m=found.tip_m - displacement_m, rotation=np.full((3, 3), np.nan), pose_covariance=covariance
        )

    def _corners_at(self, t_ns: int, k: int, taken_ns: int, detection: Detection) -> Corners | None:
        """Extrapolate camera `k`'s corners to time `t_ns`; None without corners or a speed."""
        corners = detection.corners
        if corners is None:
            return None
        before, now = (
            self._previous_corners[k],
            _with_speed(self._previous_corners[k], taken_ns, corners.padded(len(self._points_m)), self._recent_ns),
        )
        self._previous_corners[k] = now
        if abs(t_ns - taken_ns) <= _SIMULTANEOUS_NS:
            return corners
        if now.speed is None or now.change is None:
            return None
        if corners.seen is not None:
            # A corner that was hidden before has no speed yet.
            has_speed = np.asarray(np.isfinite(now.change[corners.seen]).all(axis=1))
            if has_speed.sum() < _LEAST_CORNERS:
                return None
            corners = corners.keeping(has_speed)
        changes = [now.change] if before is None or before.change is None else [now.change, before.change]
        greatest = max(changes, key=lambda change: float(np.nansum(np.square(change))))
        by_ns = t_ns - taken_ns
        change, speed = corners.of(np.where(np.isfinite(greatest), greatest, now.change)), corners.of(now.speed)
        return replace(corners, px=corners.px + speed * by_ns, carried_px=_CHANGE_SHARE * change * by_ns)

    def _velocity(self, t_ns: int, tip_m: Array) -> Array:
        """Return the tip's velocity [m/ns]; zero without a recent measurement."""
        before = self._previous_tip
        if before is None or not 0 < t_ns - before.t_ns < self._recent_ns:
            return np.zeros(3)
        return (tip_m - before.place) / (t_ns - before.t_ns)

    def _in_world(self, camera: RigidTransform) -> RigidTransform:
        moved = self._world_in_base.inverse() @ camera
        return replace(moved, translation_std_m=camera.translation_std_m, rotation_std_rad=camera.rotation_std_rad)

    def _placement_std_px(self, camera: DLT) -> float:
        """Return the standard deviation of the projection due to the camera's pose uncertainty [px]."""
        slope = camera.by_coefficients(self._points_m)
        return float(np.sqrt(np.trace(slope @ camera.covariance @ slope.T) / len(self._points_m)))


def _with_speed(before: _PreviousEstimate | None, t_ns: int, px: Array, recent_ns: float) -> _PreviousEstimate:
    """Return corners at a time with speed and its change; the change of a first speed is the speed itself."""
    if before is None or not 0 < t_ns - before.t_ns < recent_ns:
        return _PreviousEstimate(t_ns, px)
    speed = (px - before.place) / (t_ns - before.t_ns)
    return _PreviousEstimate(t_ns, px, speed, speed if before.speed is None else speed - before.speed)


def _unused(seen: DetectionStatus) -> DetectionStatus:
    """Return the status of a camera that did not contribute to the tip."""
    return DetectionStatus.NO_FRAME if seen is DetectionStatus.MEASURED else seen
