"""Intel RealSense cameras through librealsense: the colour stream, live or from a recording.

The SR300 left librealsense after 2.54.2; its colour stream is plain UVC, so it is opened with the `opencv` driver.
"""

from __future__ import annotations

import importlib
import time
from pathlib import Path
from typing import Any

import numpy as np

from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.hardware.cameras.base import CameraError, Frame, wrong_size

RECORDINGS = frozenset({".bag", ".db3"})
ANY = "any"
"""The device's name in the rig's file where there is one RealSense only; else its serial number, or a recording."""

# The colour sensor counts exposure in units of 100 us.
_EXPOSURE_UNIT_MS = 0.1


def open_camera(config: RigConfig, name: str, seed: int) -> RealSenseCamera:
    """Open a camera, which the rig file names by its serial number."""
    return RealSenseCamera(config.cameras[name])


def why_unusable(error: ImportError) -> tuple[str, str]:
    """Why `import pyrealsense2` failed, and the remedy."""
    if isinstance(error, ModuleNotFoundError):
        return "driver realsense needs pyrealsense2", "pip install pyrealsense2"
    # The package holds librealsense, but not the library of the system that librealsense needs.
    return f"pyrealsense2 cannot be loaded ({error})", "sudo apt-get install libusb-1.0-0"


class RealSenseCamera:
    """A RealSense's colour stream. The camera's own frame number is the index, so that a gap is a lost picture."""

    def __init__(self, camera: CameraConfig) -> None:
        """Open `camera.device`: a serial number, `any`, or a recording (.bag, .db3)."""
        try:
            self._rs: Any = importlib.import_module("pyrealsense2")
        except ImportError as why:
            raise CameraError("{}: {}".format(*why_unusable(why))) from None
        rs, self._camera = self._rs, camera
        self._half_exposure_ns = round(camera.exposure_ms * 5e5)
        device = str(camera.device)
        wanted = rs.config()
        recorded = Path(device).suffix in RECORDINGS
        if recorded:
            if not Path(device).is_file():
                raise CameraError(f"recording {device} does not exist")
            rs.config.enable_device_from_file(wanted, device, repeat_playback=False)
            wanted.enable_stream(rs.stream.color)
        else:
            if device != ANY:
                wanted.enable_device(device)
            size = camera.width_px, camera.height_px
            wanted.enable_stream(rs.stream.color, *size, rs.format.bgr8, round(camera.rate_hz))
        # One picture waits for a reader; an older one is dropped, not delivered late.
        self._queue = rs.frame_queue(1)
        self._pipeline = rs.pipeline()
        try:
            profile = self._pipeline.start(wanted, self._queue)
        except RuntimeError as error:
            raise CameraError(f"RealSense {device} cannot be opened: {error}") from error
        if not recorded:
            self._fix_exposure(profile)

    def _fix_exposure(self, profile: Any) -> None:
        sensor = profile.get_device().first_color_sensor()
        sensor.set_option(self._rs.option.enable_auto_exposure, 0)
        sensor.set_option(self._rs.option.exposure, self._camera.exposure_ms / _EXPOSURE_UNIT_MS)
        if self._camera.gain is not None:
            sensor.set_option(self._rs.option.gain, self._camera.gain)

    def read(self, timeout_s: float) -> Frame:
        rs = self._rs
        try:
            frame = self._queue.wait_for_frame(round(timeout_s * 1000))
        except RuntimeError as error:
            raise CameraError(f"RealSense {self._camera.device} gave no picture within {timeout_s:g} s") from error
        arrived = time.monotonic_ns()
        if frame.is_frameset():
            frame = frame.as_frameset().get_color_frame()
        # The array is the frame's own memory, which librealsense takes back.
        image = np.array(frame.get_data(), dtype=np.uint8)
        if wrong := wrong_size(self._camera, image.shape[1], image.shape[0]):
            raise CameraError(f"RealSense {self._camera.device} delivers {wrong}")
        if frame.get_profile().format() == rs.format.rgb8:
            image = np.ascontiguousarray(image[:, :, ::-1])
        end_ns = arrived
        if frame.get_frame_timestamp_domain() in (rs.timestamp_domain.global_time, rs.timestamp_domain.system_time):
            # Wall-clock milliseconds, brought to this process's monotonic clock; a recording's lie in the past.
            age_ns = time.time_ns() - round(frame.get_timestamp() * 1e6)
            if 0 <= age_ns < 1_000_000_000:
                end_ns = time.monotonic_ns() - age_ns
        return Frame(int(frame.get_frame_number()), end_ns - self._half_exposure_ns, image)

    def close(self) -> None:
        self._pipeline.stop()
