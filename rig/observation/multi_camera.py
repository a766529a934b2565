"""All cameras' eyes: pictures taken together in, the tip measured from all that see the board out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.dlt import DLT, DLTError
from calibration.vision.corners import Corners
from calibration.vision.multiview_pose import board_pose
from calibration.vision.tcp import tip_in_base
from calibration.vision.tracker import Detection
from calibration.vision.transforms import RigidTransform
from rig.config.optics import board_in_tip, board_of, camera_in_base, lens_of
from rig.config.schema import RigConfig
from rig.hardware.cameras.base import Frame, FrameSet
from rig.observation.single_camera import Measurement, SingleCameraTipEstimator
from runs.records import DetectionStatus

Floats = NDArray[np.float64]

_GLIMPSE_ROWS = 16
"""Every so many rows of a picture are compared with the last one's: a sensor's noise never repeats."""
# Exposures closer together than this are one.
_SIMULTANEOUS_NS = 100_000
# Speeds are told from pictures no further apart than so many periods. One camera's is right but for this share;
# corners' but for this share of its greatest change between the last pictures, as long as they have moved alike.
_RECENT_PERIODS = 4.5
_SPEED_SHARE = 0.3
_CHANGE_SHARE = 1.0
# Residuals of all cameras together beyond this, and beyond what their places are uncertain by, contradict each other.
_WORST_PX = 0.6
_PLACE_STDS = 3.0


@dataclass(frozen=True)
class _PreviousEstimate:
    """Where something was: corners in a picture [px], or the tip [m]; its speed [1/ns] and the change of that."""

    t_ns: int
    place: Floats
    speed: Floats | None = None
    change: Floats | None = None


class MultiCameraTipEstimator:
    """Measures the tip in the frame sets of the rig's cameras, in their order.

    Two or more pictures with the board give one pose in the world (`calibration.vision.multiview_pose`). Where only
    one camera sees the board, that camera alone measures the tip.
    """

    def __init__(self, config: RigConfig) -> None:
        self._eyes = [SingleCameraTipEstimator(config, name) for name in config.cameras]
        self._glimpses: list[NDArray[np.uint8] | None] = [None] * len(self._eyes)
        self._corners_past: list[_PreviousEstimate | None] = [None] * len(self._eyes)
        self._tip_past: _PreviousEstimate | None = None
        self._recent_ns = _RECENT_PERIODS * max(1e9 / camera.rate_hz for camera in config.cameras.values())
        self._points_m = board_of(config).corners_m
        self._board_in_tip = board_in_tip(config)
        # The world's origin is the straight arm's tip, which lies before every camera that can see the board.
        self._world_in_base = RigidTransform(np.eye(3), np.array([0.0, 0.0, config.arm.geometry.length_mm * 1e-3]))
        self._places = [self._in_world(camera_in_base(camera)) for camera in config.cameras.values()]
        self._dlts = (
            [DLT.of_camera(lens_of(c), p) for c, p in zip(config.cameras.values(), self._places, strict=True)]
            if len(self._eyes) > 1
            else []
        )

    def measure(self, shot: FrameSet) -> Measurement:
        """Measure the tip in the next shot, at the time of its leading frame."""
        sightings = [self._look(k, frame) for k, frame in enumerate(shot.frames)]
        found = self._together(shot, sightings) or self._alone(shot, sightings)
        if found.seen is DetectionStatus.MEASURED:
            self._tip_past = _PreviousEstimate(shot.t_ns, found.tip_m)
        leading = sightings[shot.leader].corners
        shown = leading.px if found.seen is DetectionStatus.MEASURED and leading is not None else None
        board = tuple(None if sighting.corners is None else sighting.corners.px for sighting in sightings)
        return replace(found, corners_px=shown, board_px=board)

    def _look(self, k: int, frame: Frame | None) -> Detection:
        """What camera `k` saw; nothing in a picture that is the last one once more, because that camera hangs."""
        if frame is None:
            return Detection(DetectionStatus.NO_FRAME)
        before, glimpse = self._glimpses[k], frame.image[::_GLIMPSE_ROWS].copy()
        self._glimpses[k] = glimpse
        # A picture all black or white has no noise to tell by.
        if before is not None and np.array_equal(before, glimpse) and before.min() != before.max():
            return Detection(DetectionStatus.NO_FRAME)
        return self._eyes[k].tracker.detect(frame.image)

    def _together(self, shot: FrameSet, sightings: Sequence[Detection]) -> Measurement | None:
        """The tip by all cameras that have the board; None where that is not two of them."""
        corners = {
            k: moved
            for k, (frame, sighting) in enumerate(zip(shot.frames, sightings, strict=True))
            if frame is not None and (moved := self._at(shot.t_ns, k, frame.t_ns, sighting)) is not None
        }
        if len(corners) < 2:
            return None
        cameras = [self._dlts[k] for k in corners]
        try:
            pose = board_pose(self._points_m, cameras, list(corners.values()))
        except (DLTError, np.linalg.LinAlgError):
            pose = None
        seen = tuple(
            DetectionStatus.MEASURED if k in corners else _unused(sighting.status)
            for k, sighting in enumerate(sightings)
        )
        allowed = _WORST_PX + _PLACE_STDS * max(self._place_std_px(camera) for camera in cameras)
        if pose is None or pose.reprojection_px > allowed:
            apart = tuple(DetectionStatus.DISAGREE if s is DetectionStatus.MEASURED else s for s in seen)
            return Measurement.none(DetectionStatus.DISAGREE, apart)
        for k in corners:
            self._eyes[k].tracker.correct_flip(sightings[k], self._places[k].inverse() @ pose.rigid)
        tip, covariance = tip_in_base(pose, self._board_in_tip, self._world_in_base)
        return Measurement(DetectionStatus.MEASURED, tip, covariance, pose.reprojection_px, None, seen)

    def _alone(self, shot: FrameSet, sightings: Sequence[Detection]) -> Measurement:
        """The tip by the first camera that measures it by itself."""
        seen = tuple(sighting.status for sighting in sightings)
        if DetectionStatus.MEASURED not in seen:
            reason = next((s for s in seen if s is not DetectionStatus.NO_FRAME), DetectionStatus.NO_FRAME)
            return Measurement.none(reason, seen)
        k = seen.index(DetectionStatus.MEASURED)
        found = self._eyes[k].judge(sightings[k])
        frame = shot.frames[k]
        assert frame is not None
        skew_ns = frame.t_ns - shot.t_ns
        tip = found.tip_m - self._velocity(frame.t_ns, found.tip_m) * skew_ns
        covariance = found.covariance_m2 + self._of_skew(frame.t_ns, found.tip_m, skew_ns)
        used = tuple(s if j == k else _unused(s) for j, s in enumerate(seen))
        return replace(found, tip_m=tip, covariance_m2=covariance, cameras=used)

    def _at(self, t_ns: int, k: int, taken_ns: int, sighting: Detection) -> Corners | None:
        """Camera `k`'s corners carried to time `t_ns` by their own speed; None where there are none, or no speed."""
        corners = sighting.corners
        if corners is None:
            return None
        before, now = self._corners_past[k], _after(self._corners_past[k], taken_ns, corners.px, self._recent_ns)
        self._corners_past[k] = now
        if abs(t_ns - taken_ns) <= _SIMULTANEOUS_NS:
            return corners
        if now.speed is None or now.change is None:
            return None
        changes = [now.change] if before is None or before.change is None else [now.change, before.change]
        greatest = max(changes, key=lambda change: float(np.square(change).sum()))
        by_ns = t_ns - taken_ns
        return replace(corners, px=corners.px + now.speed * by_ns, carried_px=_CHANGE_SHARE * greatest * by_ns)

    def _velocity(self, t_ns: int, tip_m: Floats) -> Floats:
        """Of the tip [m/ns]; none where it was not measured lately."""
        before = self._tip_past
        if before is None or not 0 < t_ns - before.t_ns < self._recent_ns:
            return np.zeros(3)
        return (tip_m - before.place) / (t_ns - before.t_ns)

    def _of_skew(self, t_ns: int, tip_m: Floats, skew_ns: int) -> Floats:
        """Covariance (3, 3) that a tip has because it was carried over a time by an uncertain speed."""
        if abs(skew_ns) <= _SIMULTANEOUS_NS:
            return np.zeros((3, 3))
        way = self._velocity(t_ns, tip_m) * (skew_ns * _SPEED_SHARE)
        return np.outer(way, way)

    def _in_world(self, camera: RigidTransform) -> RigidTransform:
        moved = self._world_in_base.inverse() @ camera
        return replace(moved, translation_std_m=camera.translation_std_m, rotation_std_rad=camera.rotation_std_rad)

    def _place_std_px(self, camera: DLT) -> float:
        """How far a camera's uncertain place moves its picture [px]."""
        slope = camera.by_coefficients(self._points_m)
        return float(np.sqrt(np.trace(slope @ camera.covariance @ slope.T) / len(self._points_m)))


def _after(before: _PreviousEstimate | None, t_ns: int, px: Floats, recent_ns: float) -> _PreviousEstimate:
    """Corners at a time, their speed and its change by what they were before; a first speed may be all wrong."""
    if before is None or not 0 < t_ns - before.t_ns < recent_ns:
        return _PreviousEstimate(t_ns, px)
    speed = (px - before.place) / (t_ns - before.t_ns)
    return _PreviousEstimate(t_ns, px, speed, speed if before.speed is None else speed - before.speed)


def _unused(seen: DetectionStatus) -> DetectionStatus:
    """What is said of a camera that the tip was not measured from."""
    return DetectionStatus.NO_FRAME if seen is DetectionStatus.MEASURED else seen
