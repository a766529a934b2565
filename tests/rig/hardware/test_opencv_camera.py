"""Cameras opened from the rig file: recordings play, missing devices are named."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

import rig.config.loader
import rig.config.schema
from rig.config.sections import CameraTrigger
from rig.hardware.cameras.base import CameraError, open_camera


@pytest.fixture(scope="module")
def config() -> rig.config.schema.RigConfig:
    return rig.config.loader.load("mock")


def _with(config: rig.config.schema.RigConfig, **changes: object) -> rig.config.schema.RigConfig:
    camera = config.cameras["front"].model_copy(update=changes)
    return config.model_copy(update={"cameras": {"front": camera}})


def _folder(path: Path, count: int, size: tuple[int, int] = (640, 480)) -> Path:
    for k in range(count):
        cv2.imwrite(str(path / f"{k:03}.png"), np.full(size[::-1], 10 * k, np.uint8))
    return path


def test_a_folder_plays_every_picture_once_at_the_rigs_rate(
    config: rig.config.schema.RigConfig, tmp_path: Path
) -> None:
    rig_ = _with(config, driver="opencv", device=str(_folder(tmp_path, 4)), rate_hz=100.0)
    camera = open_camera(rig_, "front")
    began = time.monotonic_ns()
    frames = [camera.read(1.0) for _ in range(4)]
    assert [f.index for f in frames] == [0, 1, 2, 3]
    assert [int(f.image[0, 0]) for f in frames] == [0, 10, 20, 30]
    assert set(np.diff([f.t_ns for f in frames])) == {10_000_000}
    assert time.monotonic_ns() - began >= 29_000_000
    assert frames[0].truth_m is None
    with pytest.raises(CameraError, match="ended after 4 pictures"):
        camera.read(1.0)
    camera.close()


def test_a_recording_cannot_be_triggered(config: rig.config.schema.RigConfig, tmp_path: Path) -> None:
    trigger = CameraTrigger(card="daq", channel=0)
    rig_ = _with(config, driver="opencv", device=str(_folder(tmp_path, 1)), trigger=trigger)
    with pytest.raises(CameraError, match="front plays a recording, which no card can trigger"):
        open_camera(rig_, "front")
    open_camera(rig_.free_running, "front").close()


def test_a_recording_of_another_size_is_refused(config: rig.config.schema.RigConfig, tmp_path: Path) -> None:
    rig_ = _with(config, driver="opencv", device=str(_folder(tmp_path, 1, (320, 240))))
    with pytest.raises(CameraError, match=r"320x240 and the rig asks for 640x480"):
        open_camera(rig_, "front")


def test_a_missing_video_is_named(config: rig.config.schema.RigConfig, tmp_path: Path) -> None:
    with pytest.raises(CameraError, match="does not exist"):
        open_camera(_with(config, driver="opencv", device=str(tmp_path / "gone.mp4")), "front")


def test_a_missing_device_is_named(config: rig.config.schema.RigConfig) -> None:
    with pytest.raises(CameraError, match="/dev/video987 does not exist"):
        open_camera(_with(config, driver="opencv", device="/dev/video987"), "front")


def test_a_file_that_is_not_a_camera_cannot_be_opened(config: rig.config.schema.RigConfig, tmp_path: Path) -> None:
    file = tmp_path / "device"
    file.write_bytes(b"nothing")
    with pytest.raises(CameraError, match="cannot be opened"):
        open_camera(_with(config, driver="opencv", device=str(file)), "front")


def test_a_mock_camera_without_plant_is_an_error_that_names_the_command(config: rig.config.schema.RigConfig) -> None:
    card = config.cards["daq"].model_copy(update={"device": "no-such-plant"})
    with pytest.raises(CameraError, match="camera front: mock card no-such-plant does not exist"):
        open_camera(config.model_copy(update={"cards": {"daq": card}}), "front")
