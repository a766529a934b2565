"""One measurement of the tip, by cameras or a tracker: the tip with its covariance, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from model.arrays import Array
from rig.hardware.trackers.base import TrackerReading
from runs.records import DetectionStatus


@dataclass(frozen=True)
class TipMeasurement:
    """The tip (3,) [m] in the rod-base frame; NaN and no corners unless `seen` is MEASURED.

    `rotation` (3, 3) is the tip frame in the rod-base frame, `pose_covariance` (6, 6) that of the position [m] and of a
    small rotation [rad] about the axes of the rod base. Both are NaN where the orientation is of another time.
    `corners_px` are those in the picture of the first camera that has one, NaN where one is hidden. `cameras` is what
    each of the rig's cameras saw: the tip was measured from those that are MEASURED.
    """

    seen: DetectionStatus
    tip_m: Array
    rotation: Array
    pose_covariance: Array
    reprojection_px: float
    corners_px: Array | None
    cameras: tuple[DetectionStatus, ...]
    board_px: tuple[Array | None, ...] = ()
    """The corners in each camera's picture."""

    @property
    def covariance_m2(self) -> Array:
        """Covariance (3, 3) of the position."""
        return self.pose_covariance[:3, :3]

    @property
    def rotation_vector(self) -> Array:
        """Rotation vector (3,) [rad] of the orientation; NaN without one."""
        if not np.isfinite(self.rotation).all():
            return np.full(3, np.nan)
        return np.asarray(cv2.Rodrigues(self.rotation)[0], np.float64).ravel()

    @classmethod
    def of_reading(cls, reading: TrackerReading | None) -> TipMeasurement:
        """Return the measurement of a tracker; without a tip where it is silent or does not see the body."""
        if reading is None or not reading.seen:
            return cls.none(DetectionStatus.NO_MESSAGE if reading is None else DetectionStatus.NO_POSE, ())
        pose = reading.position_m, reading.rotation, reading.covariance
        return cls(DetectionStatus.MEASURED, *pose, float("nan"), None, ())

    @classmethod
    def none(cls, seen: DetectionStatus, cameras: tuple[DetectionStatus, ...]) -> TipMeasurement:
        """Return a measurement without a tip, with the reason."""
        tip, rotation, covariance = np.full(3, np.nan), np.full((3, 3), np.nan), np.full((6, 6), np.nan)
        return cls(seen, tip, rotation, covariance, float("nan"), None, cameras)
