"""Selection and encoding of the camera pictures to store, with image annotations."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.config.schema import RigConfig
from rig.config.sections import Recording
from rig.hardware.cameras.base import FrameSet
from rig.observation.observer import Observer
from rig.observation.overlay import OverlayProjector
from runs.records import DetectionStatus, Picture


class PictureRecorder:
    """Stores every `keep_every`th frame set, and the one in which the board is lost."""

    def __init__(self, config: RigConfig) -> None:
        self._recording = config.recording
        self._projectors = {name: OverlayProjector(config, name) for name in config.cameras}
        self._lost = False
        self._last_loss: int | None = None

    def pictures(self, frame_set: FrameSet, observer: Observer) -> list[Picture]:
        """Return the pictures to store of the frame set that the observer has just processed."""
        measurement = observer.measurement
        if measurement is None or not self._keeps(frame_set.index, measurement.seen):
            return []
        corners = measurement.board_px or (None,) * len(frame_set.frames)
        return [
            Picture(
                t_ns=frame.t_ns,
                frame=frame_set.index,
                camera=name,
                encoding=self._recording.encoding,
                data=encode(frame.image, self._recording),
                marks=projector.annotations(board, measurement.tip_m, observer.shape),
            )
            for (name, projector), frame, board in zip(self._projectors.items(), frame_set.frames, corners, strict=True)
            if frame is not None
        ]

    def _keeps(self, index: int, seen: DetectionStatus) -> bool:
        """Return whether to store a frame set; pictures of losses are stored at most every `keep_every` frames."""
        every = self._recording.keep_every
        lost, self._lost = not self._lost and seen is not DetectionStatus.MEASURED, seen is not DetectionStatus.MEASURED
        if index % every == 0:
            return True
        if lost and (self._last_loss is None or index - self._last_loss >= every):
            self._last_loss = index
            return True
        return False


def encode(image: NDArray[np.uint8], recording: Recording) -> bytes:
    """Compress one picture as the rig configures."""
    if recording.encoding == "png":
        ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    else:
        ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, recording.jpeg_quality])
    if not ok:
        raise ValueError(f"a picture of shape {image.shape} could not be encoded as {recording.encoding}")
    return data.tobytes()
