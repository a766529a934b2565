"""What softrig relies on in a camera driver."""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from rig.config.schema import RigConfig
from rig.driver_contract.check import BrokenContractError, Check
from rig.driver_contract.time_stamps import rate_and_age
from rig.hardware.cameras.base import Frame
from rig.hardware.cameras.opening import open_camera

FRAMES = 15
TIMEOUT_S = 2.0


@dataclass(frozen=True)
class CameraSubject:
    """A camera under test."""

    config: RigConfig
    name: str

    def frames(self) -> list[tuple[Frame, int]]:
        """Some frames with the times of their arrival [ns]."""
        with closing(open_camera(self.config.free_running, self.name)) as camera:
            return [(camera.read(TIMEOUT_S), time.monotonic_ns()) for _ in range(FRAMES)]


def pictures(subject: CameraSubject) -> str:
    """Pictures have the size of the rig file."""
    camera = subject.config.cameras[subject.name]
    frames = [frame for frame, _ in subject.frames()]
    for frame in frames:
        shape = frame.image.shape
        if frame.image.dtype != np.uint8 or shape[:2] != (camera.height_px, camera.width_px):
            raise BrokenContractError(f"a picture has the shape {shape} and the type {frame.image.dtype}")
        if shape[2:] not in ((), (3,)):
            raise BrokenContractError(f"a picture has {shape[2]} channels; grey or BGR is expected")
    return f"{len(frames)} pictures of {shape[1]} x {shape[0]}, {'BGR' if shape[2:] else 'grey'}"


def stamps(subject: CameraSubject) -> str:
    """Every picture is new, with a time of CLOCK_MONOTONIC."""
    frames = subject.frames()
    measured = rate_and_age(frames, "pictures", subject.config.cameras[subject.name].rate_hz)
    dropped = frames[-1][0].index - frames[0][0].index - (len(frames) - 1)
    return f"{measured}, {dropped} dropped"


def reopening(subject: CameraSubject) -> str:
    """A camera can be opened again once it is closed."""
    began = time.monotonic()
    for _ in range(2):
        with closing(open_camera(subject.config.free_running, subject.name)) as camera:
            camera.read(TIMEOUT_S)
    serial = subject.config.cameras[subject.name].serial()
    return f"opened twice in {time.monotonic() - began:.1f} s, serial number {serial or 'none'}"


CAMERA_CHECKS: tuple[Check[CameraSubject], ...] = (
    Check("pictures", "uint8, grey or BGR, in the size of the rig file", pictures),
    Check("stamps", "the middle of the exposure on CLOCK_MONOTONIC, increasing, at rate_hz", stamps),
    Check("reopening", "a closed camera can be opened again", reopening),
)
