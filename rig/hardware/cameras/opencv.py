"""The `opencv` driver: V4L2 devices, and recorded pictures in their place."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NoReturn

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.views import IMAGE_SUFFIXES, VIDEO_SUFFIXES, View, ViewsError, views_in
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.hardware.cameras.base import Camera, CameraError, Frame, wrong_size

VIDEO_DEVICES = Path("/sys/class/video4linux")
# V4L2's auto_exposure menu, as OpenCV passes it through.
_MANUAL_EXPOSURE = 1
# The control counts in units of 100 us.
_EXPOSURE_UNIT_MS = 0.1
# A stamp further from the time of arrival than this is on another clock.
_SAME_CLOCK_S = 2.0


def open_camera(config: RigConfig, name: str, seed: int) -> Camera:
    """Open a V4L2 device, or a recording: a folder of pictures or a video file."""
    camera = config.cameras[name]
    if not is_recording(camera.device):
        return OpenCVCamera(camera)
    if camera.trigger is not None:
        raise CameraError(f"camera {name} plays a recording, which no card can trigger: remove its `trigger`")
    return RecordedCamera(camera)


class OpenCVCamera:
    """A V4L2 camera that keeps one buffer, so that a picture is never older than one period.

    Frames are stamped by the driver where its stamps are on CLOCK_MONOTONIC, else on arrival, and moved back by half
    the exposure. Lost pictures show as gaps of the index, told from the stamps.
    """

    def __init__(self, camera: CameraConfig) -> None:
        """Open `camera.device`, a number or a path, and set size, rate and exposure; refuse another size."""
        self._camera = camera
        device = camera.device
        if isinstance(device, str) and device.startswith("/") and not Path(device).exists():
            raise CameraError(f"camera {device} does not exist: plug it in, or list what there is with `rig doctor`")
        self._capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise CameraError(
                f"camera {device} cannot be opened: is it in use, and may this user read it (group video)?"
            )
        self._prepare()
        self._period_ns = round(1e9 / camera.rate_hz)
        self._half_exposure_ns = round(camera.exposure_ms * 5e5)
        self._index = -1
        self._last_ns = 0

    def _prepare(self) -> None:
        capture, camera = self._capture, self._camera
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if camera.pixel_format is not None:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*camera.pixel_format))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height_px)
        capture.set(cv2.CAP_PROP_FPS, camera.rate_hz)
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        capture.set(cv2.CAP_PROP_EXPOSURE, camera.exposure_ms / _EXPOSURE_UNIT_MS)
        if camera.gain is not None and not capture.set(cv2.CAP_PROP_GAIN, camera.gain):
            self._refuse(f"has no gain that can be set to {camera.gain:g}: leave `gain` out")
        if camera.pixel_format is not None and (given := self._pixel_format()) != camera.pixel_format:
            self._refuse(f"delivers {given} and the rig asks for {camera.pixel_format}: `v4l2-ctl --list-formats`")
        size_px = round(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if wrong := wrong_size(camera, *size_px):
            self._refuse(f"delivers {wrong}")

    def _pixel_format(self) -> str:
        return int(self._capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace")

    def _refuse(self, why: str) -> NoReturn:
        self._capture.release()
        raise CameraError(f"camera {self._camera.device} {why}")

    def read(self, timeout_s: float) -> Frame:
        until = time.monotonic() + timeout_s
        while not self._grab(until - time.monotonic()):
            if time.monotonic() > until:
                raise CameraError(f"camera {self._camera.device} gave no picture within {timeout_s:g} s")
            time.sleep(0.002)
        arrived = time.monotonic_ns()
        stamp = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        end_ns = stamp if 0 <= arrived - stamp < _SAME_CLOCK_S * 1e9 else arrived
        ok, image = self._capture.retrieve()
        if not ok:
            raise CameraError(f"camera {self._camera.device} gave a picture that cannot be decoded")
        elapsed = max(1, round((end_ns - self._last_ns) / self._period_ns)) if self._index >= 0 else 1
        self._index += elapsed
        self._last_ns = end_ns
        picture: NDArray[np.uint8] = np.asarray(image, dtype=np.uint8)
        return Frame(self._index, end_ns - self._half_exposure_ns, picture)

    def _grab(self, timeout_s: float) -> bool:
        """Take the next picture; False if none has come in time, or if the device reports an error.

        `VideoCapture.grab` would wait ten seconds, whatever it is asked.
        """
        try:
            ready, _ = cv2.VideoCapture.waitAny([self._capture], max(1, round(timeout_s * 1e3)) * 10**6)
        except cv2.error:
            return False
        return ready

    def close(self) -> None:
        self._capture.release()


def serial_of(camera: CameraConfig, devices: Path = VIDEO_DEVICES) -> str | None:
    """Serial number of the USB device behind a V4L2 camera; None where there is none or it has none."""
    device = camera.device
    name = f"video{device}" if isinstance(device, int) else Path(device).resolve().name
    node = devices / name / "device"
    if not node.exists():
        return None
    # The interface's folder stands inside the device's, which has the number.
    for folder in (node.resolve(), *node.resolve().parents[:3]):
        number = folder / "serial"
        if number.is_file():
            return number.read_text(encoding="ascii", errors="replace").strip() or None
    return None


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
