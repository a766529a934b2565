"""RealSense without a camera: librealsense's software device is recorded, and the recording is played back."""

from __future__ import annotations

import importlib
import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig.config.loader
import rig.config.sections
from rig.hardware.cameras.base import CameraError
from rig.hardware.cameras.realsense import RealSenseCamera
from tests.support.absent import absent


def _camera(device: str) -> rig.config.sections.CameraConfig:
    config = rig.config.loader.load("mock").cameras["front"]
    return config.model_copy(update={"driver": "realsense", "device": device})


def _librealsense() -> Any:
    """The library; skips where it or what it needs is missing."""
    try:
        return importlib.import_module("pyrealsense2")
    except ModuleNotFoundError:
        pytest.skip("the optional package pyrealsense2 is not installed")
    except (ImportError, OSError) as why:
        absent(f"pyrealsense2 cannot be loaded ({why}): sudo apt-get install libusb-1.0-0")


def _record(rs: Any, file: Path, pictures: list[np.ndarray]) -> None:
    """A software device with one colour stream, its frames written to a file."""
    device = rs.software_device()
    sensor = device.add_sensor("color")
    stream = rs.video_stream()
    stream.type, stream.fmt, stream.bpp, stream.fps = rs.stream.color, rs.format.bgr8, 3, 30
    stream.width, stream.height, stream.uid, stream.index = 640, 480, 1, 0
    profile = sensor.add_video_stream(stream)
    recorder = rs.recorder(str(file), device)
    recorded = recorder.query_sensors()[0]
    queue = rs.frame_queue(50)
    recorded.open(profile)
    recorded.start(queue)
    for k, picture in enumerate(pictures):
        frame = rs.software_video_frame()
        frame.pixels, frame.stride, frame.bpp = picture, 640 * 3, 3
        frame.timestamp, frame.domain = 1000.0 + 33.0 * k, rs.timestamp_domain.hardware_clock
        frame.frame_number, frame.profile = 10 + k, profile.as_video_stream_profile()
        sensor.on_video_frame(frame)
        time.sleep(0.03)
    recorded.stop()
    recorded.close()


def test_a_recording_plays_with_the_cameras_own_frame_numbers(tmp_path: Path) -> None:
    rs = _librealsense()
    pictures = [np.full((480, 640, 3), (10 * k, 5, 200), np.uint8) for k in range(12)]
    file = tmp_path / "run.db3"
    _record(rs, file, pictures)
    camera = RealSenseCamera(_camera(str(file)))
    try:
        frames = [camera.read(3.0) for _ in range(4)]
    finally:
        camera.close()
    assert all(b.index > a.index for a, b in itertools.pairwise(frames))
    for frame in frames:
        assert np.array_equal(frame.image, pictures[frame.index - 10])


@pytest.mark.parametrize(
    ("error", "remedy"),
    [
        (ModuleNotFoundError("No module named 'pyrealsense2'"), "pip install pyrealsense2"),
        (
            ImportError("libusb-1.0.so.0: cannot open shared object file"),
            "libusb-1.0.so.0.*apt-get install libusb-1.0-0",
        ),
    ],
)
def test_without_the_package_or_its_library_the_message_names_it(
    error: ImportError, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.import_module

    def none(name: str, package: str | None = None) -> Any:
        if name == "pyrealsense2":
            raise error
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", none)
    with pytest.raises(CameraError, match=remedy):
        RealSenseCamera(_camera("any"))


def test_a_missing_recording_is_named() -> None:
    _librealsense()
    with pytest.raises(CameraError, match=r"gone\.db3 does not exist"):
        RealSenseCamera(_camera("/tmp/gone.db3"))
