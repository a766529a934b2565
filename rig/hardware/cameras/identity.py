"""Which camera is plugged in: the serial number that the system or the driver tells."""

from __future__ import annotations

from pathlib import Path

from rig.config.schema import CameraConfig

_VIDEO = Path("/sys/class/video4linux")


def serial_of(camera: CameraConfig, devices: Path = _VIDEO) -> str | None:
    """Serial number of a rig's camera as it is plugged in now; None where none can be told.

    A RealSense is opened by its serial number. A V4L2 camera's is that of its USB device.
    """
    if camera.driver == "realsense":
        return str(camera.device)
    if camera.driver != "opencv":
        return None
    name = f"video{camera.device}" if isinstance(camera.device, int) else Path(camera.device).resolve().name
    node = devices / name / "device"
    if not node.exists():
        return None
    # The interface's folder stands inside the device's, which has the number.
    for folder in (node.resolve(), *node.resolve().parents[:3]):
        number = folder / "serial"
        if number.is_file():
            return number.read_text(encoding="ascii", errors="replace").strip() or None
    return None
