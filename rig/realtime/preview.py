"""Publishes camera frames to viewers; without a viewer nothing is computed or copied."""

from __future__ import annotations

import time

import numpy as np

from rig.config.schema import RigConfig
from rig.hardware.cameras.base import FrameSet
from rig.observation.observer import Observer
from rig.observation.overlay import OverlayProjector, arm_lines
from rig.realtime.picture_rings import LINE_POINTS, view_dtype
from rig.realtime.shared_state import SharedState

WATCHED_NS = 3_000_000_000
"""A viewer reports its presence about once a second."""
_NO_PICTURE = np.empty((0, 0, 0), np.uint8)


class PreviewPublisher:
    """Publishes frames with their overlay through the shared memory."""

    def __init__(self, config: RigConfig, memory: SharedState) -> None:
        self._config, self._memory = config, memory
        self._projectors = [OverlayProjector(config, name) for name in config.cameras]
        self._row = np.zeros((), view_dtype(config))

    def publish(self, frame_set: FrameSet, observer: Observer) -> None:
        """Publish the leading frame of the frame set that the observer has just observed, if there is a viewer.

        Without cameras the picture is empty, and the overlay is the lines of the arm.
        """
        watched = time.monotonic_ns() - self._memory.viewer_ns <= WATCHED_NS
        if not watched or observer.measurement is None:
            return
        row = self._row
        row["t_ns"], row["frame"] = frame_set.t_ns, frame_set.index
        row["lines_m"] = arm_lines(self._config, observer.shape, LINE_POINTS)
        if not frame_set.frames:
            row["shape"], row["found"], row["tip_px"], row["model_px"] = 0, 0, np.nan, np.nan
            self._memory.views.push(row, _NO_PICTURE)
            return
        frame, measurement = frame_set.lead, observer.measurement
        projector = self._projectors[frame_set.leader]
        marks = projector.annotations(measurement.corners_px, measurement.tip_m, observer.shape)
        corners_px = marks.corners_px[np.isfinite(marks.corners_px).all(axis=1)]
        row["shape"] = (*frame.image.shape, 1)[:3]
        row["found"] = len(corners_px)
        row["corners_px"][: len(corners_px)] = corners_px
        row["tip_px"], row["model_px"] = marks.tip_px, marks.model_px
        self._memory.views.push(row, frame.image)
