"""The serial number of a V4L2 camera, as the kernel reports it."""

from __future__ import annotations

from pathlib import Path

VIDEO_DEVICES = Path("/sys/class/video4linux")


def v4l2_serial(device: str | int, devices: Path = VIDEO_DEVICES) -> str | None:
    """Serial number of the USB device behind a V4L2 camera; None where there is none or it has none."""
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
