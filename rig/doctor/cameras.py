"""Checks of the machine's cameras and of those that a rig names."""

from __future__ import annotations

import fcntl
import importlib
import os
import struct
from pathlib import Path
from typing import Any

from rig.config.finding import Finding
from rig.config.schema import RigConfig
from rig.config.sections import CameraConfig
from rig.doctor.machine import group_name
from rig.hardware.cameras.realsense import ANY, RECORDINGS, why_unusable

_VIDIOC_QUERYCAP = 0x80685600
_CAPABILITIES = "<16s32s32sIII12x"
"""V4L2's answer to it: driver, card, bus, version, what the device can do and what this node of it can."""
_VIDEO_CAPTURE = 0x1 | 0x1000
"""Pictures, in one plane or several."""
_TOLD_BY_NODE = 0x80000000
_PLUG_IN = "plug the camera in (`dmesg` says whether it was seen)"


def cameras(root: Path = Path("/")) -> list[Finding]:
    """Check every video device: its name, the permission, and whether it captures pictures."""
    devices = _devices(root)
    if not devices:
        return [Finding("camera", "note", "no /dev/video*", f"{_PLUG_IN}; dry runs need none")]
    return [_video(device, root) for device in devices]


def rig_cameras(config: RigConfig, root: Path = Path("/")) -> list[Finding]:
    """Whether the cameras that a rig names are there and may be opened; none is, a run may be using them."""
    return [
        _CHECKS[camera.driver](f"rig's camera {name}", camera, root)
        for name, camera in config.cameras.items()
        if camera.driver in _CHECKS
    ]


def _devices(root: Path) -> list[Path]:
    found = (path for path in (root / "dev").glob("video[0-9]*") if path.name[5:].isdigit())
    return sorted(found, key=lambda path: int(path.name[5:]))


def _video(device: Path, root: Path, topic: str = "camera") -> Finding:
    node = device.resolve()
    known = (root / "sys/class/video4linux" / node.name).resolve()
    called = known / "name"
    # As the user knows it: a made-up machine stands elsewhere.
    shown = f"/{device.relative_to(root)}"
    name = f"{shown}: {called.read_text().strip()}" if called.exists() else shown
    try:
        pictures = _gives_pictures(device, hardware="virtual" not in known.parts)
    except PermissionError:
        remedy = f"sudo adduser $USER {group_name(node.stat().st_gid)}, then log in again"
        return Finding(topic, "missing", f"{name}: no permission", remedy)
    except OSError as error:
        remedy = "end the program that has it, or unplug it and plug it in again (`dmesg` says what happened)"
        return Finding(topic, "missing", f"{name}: cannot be opened ({error.strerror})", remedy)
    if not pictures:
        return Finding(
            topic,
            "note" if topic == "camera" else "missing",
            f"{name}: gives no pictures, only what a camera tells beside them",
            "take another of its devices, most often the one before",
        )
    return Finding(topic, "ok", name)


def _gives_pictures(device: Path, hardware: bool) -> bool:
    """What V4L2 says of a device; one that is none of V4L2's is left to the camera's driver.

    A device without hardware is opened only: v4l2loopback 0.12, asked while no program feeds it, refuses the next
    program that wants to feed it.

    Raises:
        OSError: it cannot be opened.
    """
    answer = bytearray(struct.calcsize(_CAPABILITIES))
    opened = os.open(device, os.O_RDWR | os.O_NONBLOCK)
    try:
        if not hardware:
            return True
        fcntl.ioctl(opened, _VIDIOC_QUERYCAP, answer)
    except OSError:
        return True
    finally:
        os.close(opened)
    *_, of_all, of_node = struct.unpack(_CAPABILITIES, answer)
    return bool((of_node if of_all & _TOLD_BY_NODE else of_all) & _VIDEO_CAPTURE)


def _opencv(topic: str, camera: CameraConfig, root: Path) -> Finding:
    from rig.hardware.cameras.recorded import is_recording  # brings OpenCV with it

    if is_recording(camera.device):
        there = Path(str(camera.device)).exists()
        found = f"recording {camera.device}" + ("" if there else " does not exist")
        return Finding(
            topic, "ok" if there else "missing", found, "" if there else "correct `device` in the rig's file"
        )
    path = f"/dev/video{camera.device}" if isinstance(camera.device, int) else camera.device
    device = root / Path(path).absolute().relative_to("/")
    if device.exists():
        return _video(device, root, topic)
    present = ", ".join(f"/dev/{other.name}" for other in _devices(root)) or "none"
    remedy = f"{_PLUG_IN}, or correct `device` in the rig's file; /dev/v4l/by-id has names that stay"
    return Finding(topic, "missing", f"{path} does not exist (video devices present: {present})", remedy)


def _realsense(topic: str, camera: CameraConfig, root: Path) -> Finding:
    wanted = str(camera.device)
    if Path(wanted).suffix in RECORDINGS:
        there = Path(wanted).is_file()
        return Finding(topic, "ok" if there else "missing", f"recording {wanted}", "correct `device` in the rig's file")
    try:
        rs: Any = importlib.import_module("pyrealsense2")
    except ImportError as why:
        found, remedy = why_unusable(why)
        return Finding(topic, "missing", found, remedy)
    serials = [device.get_info(rs.camera_info.serial_number) for device in rs.context().query_devices()]
    if wanted in serials or (wanted == ANY and serials):
        return Finding(topic, "ok", f"RealSense {wanted}")
    present = ", ".join(serials) or "none"
    return Finding(topic, "missing", f"no RealSense {wanted} (present: {present})", f"{_PLUG_IN}, or correct `device`")


_CHECKS = {"opencv": _opencv, "realsense": _realsense}
"""Checks by the driver of a camera."""
