"""Opens the cameras of a rig by the drivers of the rig file."""

from __future__ import annotations

from rig.config.drivers import CAMERA_DRIVERS
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.hardware.cameras.base import Camera, CameraDriver


def camera_driver(camera: CameraConfig) -> CameraDriver:
    """The driver of a camera, loaded."""
    driver: CameraDriver = CAMERA_DRIVERS[camera.driver].load()()
    return driver


def open_camera(config: RigConfig, name: str, seed: int = 0) -> Camera:
    """Open the rig's camera `name`; `seed` is for simulated cameras.

    Raises:
        CameraError: the camera cannot be opened.
    """
    return camera_driver(config.cameras[name]).open(config, name, seed)
