"""Encoding camera pictures for the record."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rig.config import Recording


def encode(image: NDArray[np.uint8], recording: Recording) -> bytes:
    """Compress one picture as the rig asks for."""
    if recording.encoding == "png":
        ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    else:
        ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, recording.jpeg_quality])
    if not ok:
        raise ValueError(f"a picture of shape {image.shape} could not be encoded as {recording.encoding}")
    return data.tobytes()
