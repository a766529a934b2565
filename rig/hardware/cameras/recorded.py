"""Recorded pictures as a camera: a folder of images or a video, at the rate of the rig file."""

from __future__ import annotations

import time
from pathlib import Path

from calibration.views import IMAGE_SUFFIXES, VIDEO_SUFFIXES, View, ViewsError, views_in
from rig.config.sections import CameraConfig
from rig.hardware.cameras.base import CameraError, Frame, wrong_size


def is_recording(device: str | int) -> bool:
    """True if the device of a camera is a folder of pictures or a video file."""
    if isinstance(device, int):
        return False
    path = Path(device)
    return path.is_dir() or path.suffix.lower() in VIDEO_SUFFIXES | IMAGE_SUFFIXES


class RecordedCamera:
    """Plays every picture once, in order, paced by CLOCK_MONOTONIC; a late reader loses none."""

    def __init__(self, camera: CameraConfig) -> None:
        """Open the folder or video at `camera.device`; its pictures must have the rig's size."""
        self._camera = camera
        self._views = views_in(Path(str(camera.device)))
        self._period_ns = round(1e9 / camera.rate_hz)
        self._index = -1
        self._next: View | None = self._advance()
        self._start_ns = time.monotonic_ns()

    def read(self, timeout_s: float) -> Frame:
        """Wait for the time of the next picture and return it."""
        view = self._next
        if view is None:
            raise CameraError(f"recording {self._camera.device} has ended after {self._index + 1} pictures")
        t_ns = self._start_ns + (self._index + 1) * self._period_ns
        wait_s = (t_ns - time.monotonic_ns()) * 1e-9
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            raise CameraError(f"recording {self._camera.device} gave no picture within {timeout_s:g} s")
        if wait_s > 0:
            time.sleep(wait_s)
        self._index += 1
        self._next = self._advance()
        return Frame(self._index, t_ns, view.image)

    def close(self) -> None:
        self._views.close()

    def _advance(self) -> View | None:
        try:
            view = next(self._views, None)
        except ViewsError as error:
            raise CameraError(f"camera {self._camera.device}: {error}") from error
        if view is not None:
            height_px, width_px = view.image.shape
            if wrong := wrong_size(self._camera, width_px, height_px):
                raise CameraError(f"{view.name} is {wrong}")
        return view
