"""The V4L2 camera against the kernel's vivid, and against v4l2loopback with the rendered scene played into it."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest

from rig.config.loader import load
from rig.config.sections import CameraConfig
from rig.hardware.cameras.base import CameraError, Frame, FrameSet
from rig.hardware.cameras.opencv import OpenCVCamera
from rig.observation.camera_estimator import CameraTipEstimator
from runs.records import DetectionStatus
from tests.hardware.played_pictures import RATE_HZ
from tests.hardware.rig_of_the_machine import LOOPED, Player


def camera_config(device: str, **changed: object) -> CameraConfig:
    """The looped rig's camera on another device."""
    front = load(LOOPED).cameras["front"]
    return front.model_copy(update={"device": device, **changed})


def take(camera: OpenCVCamera, count: int) -> list[Frame]:
    """So many pictures."""
    try:
        return [camera.read(timeout_s=10.0) for _ in range(count)]
    finally:
        camera.close()


def test_vivid_gives_pictures_of_the_size_asked_for_in_order() -> None:
    before = time.monotonic_ns()
    frames = take(OpenCVCamera(camera_config("/dev/video0", rate_hz=25.0)), 10)
    for earlier, later in pairwise(frames):
        assert later.index > earlier.index
        assert later.t_ns > earlier.t_ns
    assert {frame.image.shape[:2] for frame in frames} == {(480, 640)}
    assert before - 1e9 < frames[0].t_ns < frames[-1].t_ns < time.monotonic_ns()
    assert any(np.any(a.image != b.image) for a, b in pairwise(frames))


def test_a_size_that_the_camera_lacks_is_refused_with_what_it_delivers() -> None:
    with pytest.raises(CameraError, match="the rig asks for 700x500"):
        OpenCVCamera(camera_config("/dev/video0", width_px=700, height_px=500))


def test_pixel_format_and_gain_reach_the_driver() -> None:
    frames = take(OpenCVCamera(camera_config("/dev/video0", pixel_format="YUYV", gain=100.0)), 3)
    assert {frame.image.shape for frame in frames} == {(480, 640, 3)}


def test_a_pixel_format_that_the_camera_lacks_is_refused_with_what_it_delivers() -> None:
    with pytest.raises(CameraError, match="the rig asks for MJPG"):
        OpenCVCamera(camera_config("/dev/video0", pixel_format="MJPG"))


def test_a_missing_camera_is_named() -> None:
    with pytest.raises(CameraError, match="/dev/video77 does not exist"):
        OpenCVCamera(camera_config("/dev/video77"))


def test_a_rendered_scene_played_through_the_kernel_is_measured_where_it_is(player: Player) -> None:
    eye = CameraTipEstimator(load(LOOPED))
    frames = take(OpenCVCamera(camera_config("/dev/video9", rate_hz=float(RATE_HZ))), 40)
    measured = [eye.measure(FrameSet.of(frame)) for frame in frames]
    tips = np.array([m.tip_m for m in measured if m.seen is DetectionStatus.MEASURED])
    assert len(tips) > 30
    away = np.linalg.norm(tips[:, None, [0, 2]] - player.tips_m[None, :, [0, 2]], axis=2).min(axis=1)
    assert np.median(away) < 1e-3
