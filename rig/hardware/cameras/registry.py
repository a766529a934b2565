"""Cameras: the protocol they obey, OpenCV's, RealSense, and the rendered one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.hardware.cameras.base import Camera, CameraError

if TYPE_CHECKING:
    from rig.config.schema import RigConfig


def open_camera(config: RigConfig, name: str, seed: int = 0) -> Camera:
    """Open the rig's camera `name` with the driver it names; a driver is imported only when it is used.

    The mock camera looks at the plant that runs behind the rig's mock card, from any process.

    Raises:
        CameraError: the camera cannot be opened.
    """
    camera = config.cameras[name]
    if camera.driver == "mock":
        from rig.hardware.cameras.mock import MockCamera
        from rig.hardware.cards.base import CardError
        from rig.simulator.registers import Registers

        devices = [card.device for card in config.cards.values() if card.driver == "mock"]
        if not devices:
            raise CameraError(f"camera {name} is a mock, and the rig has no mock card whose plant it could look at")
        try:
            registers = Registers.attach(devices[0])
            return MockCamera(config, registers, name, seed, registers.faults)
        except CardError as error:
            raise CameraError(f"camera {name}: {error}") from error
    if camera.driver == "opencv":
        from rig.hardware.cameras.opencv import OpenCVCamera
        from rig.hardware.cameras.recorded import RecordedCamera, is_recording

        if is_recording(camera.device):
            return RecordedCamera(camera)
        return OpenCVCamera(camera)
    from rig.hardware.cameras.realsense import RealSenseCamera

    return RealSenseCamera(camera)
