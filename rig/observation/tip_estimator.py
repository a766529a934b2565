"""How a rig measures its tip: by cameras, by a tracker, or not at all."""

from __future__ import annotations

from typing import Protocol

from rig.config.schema import RigConfig
from rig.hardware.cameras.base import FrameSet
from rig.observation.camera_estimator import CameraTipEstimator
from rig.observation.tip_measurement import TipMeasurement
from runs.records import DetectionStatus


class _TipEstimator(Protocol):
    """Measures the tip in the rig's frame sets, in order."""

    def measure(self, frame_set: FrameSet) -> TipMeasurement: ...


class _NoTipEstimator:
    """The tip estimator of a rig without cameras and tracker: it measures nothing."""

    def measure(self, frame_set: FrameSet) -> TipMeasurement:
        return TipMeasurement.none(DetectionStatus.NO_CAMERA, ())


class _TrackerTipEstimator:
    """The tip estimator of a rig with a tracker, which gives the pose itself."""

    def measure(self, frame_set: FrameSet) -> TipMeasurement:
        reading = frame_set.reading
        if reading is None or not reading.seen:
            return TipMeasurement.none(DetectionStatus.NO_MESSAGE if reading is None else DetectionStatus.NO_POSE, ())
        return TipMeasurement(
            DetectionStatus.MEASURED, reading.position_m, reading.rotation, reading.covariance, float("nan"), None, ()
        )


def tip_estimator(config: RigConfig) -> _TipEstimator:
    """The tip estimator of a rig: by its tracker, by its cameras, or none."""
    if config.trackers:
        return _TrackerTipEstimator()
    return CameraTipEstimator(config) if config.cameras else _NoTipEstimator()
