"""Checks of the machine's cameras, and of a rig's cameras by their drivers."""

from __future__ import annotations

import fcntl
import importlib
import os
import struct
from pathlib import Path
from typing import Any

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.doctor.machine import group_name

_VIDIOC_QUERYCAP = 0x80685600
_CAPABILITIES = "<16s32s32sIII12x"
"""V4L2's answer to it: driver, card, bus, version, what the device can do and what this node of it can."""
_VIDEO_CAPTURE = 0x1 | 0x1000
"""Pictures, in one plane or several."""
_HAS_NODE_CAPABILITIES = 0x80000000
PLUG_IN = "plug the camera in (`dmesg` says whether it was seen)"


def cameras(root: Path = Path("/")) -> list[Finding]:
    """Check every video device: its name, the permission, and whether it captures pictures."""
    devices = video_devices(root)
    if not devices:
        return [Finding("camera", "note", "no /dev/video*", f"{PLUG_IN}; dry runs need none")]
    return [examine_video(device, root) for device in devices]


def video_devices(root: Path) -> list[Path]:
    """Return the video devices in the order of their numbers."""
    found = (path for path in (root / "dev").glob("video[0-9]*") if path.name[5:].isdigit())
    return sorted(found, key=lambda path: int(path.name[5:]))


def examine_video(device: Path, root: Path, topic: str = "camera", *, wanted: bool = False) -> Finding:
    """Check one video device; one without pictures is missing where a rig has it as `wanted`."""
    node = device.resolve()
    known = (root / "sys/class/video4linux" / node.name).resolve()
    called = known / "name"
    # The path without `root`, which tests set.
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
            "missing" if wanted else "note",
            f"{name}: gives no pictures, only metadata",
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
    return bool((of_node if of_all & _HAS_NODE_CAPABILITIES else of_all) & _VIDEO_CAPTURE)


def examine_opencv(config: RigConfig, name: str, root: Path = Path("/")) -> list[Finding]:
    """Check that the device or recording is there and may be opened; opens no video, a run may be using it."""
    from rig.hardware.cameras.opencv import is_recording  # brings OpenCV with it

    topic, camera = f"rig's camera {name}", config.cameras[name]
    if is_recording(camera.device):
        return [_recording(topic, Path(str(camera.device)))]
    path = f"/dev/video{camera.device}" if isinstance(camera.device, int) else camera.device
    device = root / Path(path).absolute().relative_to("/")
    if device.exists():
        return [examine_video(device, root, topic, wanted=True)]
    present = ", ".join(f"/dev/{other.name}" for other in video_devices(root)) or "none"
    remedy = f"{PLUG_IN}, or correct `device` in the rig's file; /dev/v4l/by-id has names that stay"
    return [Finding(topic, "missing", f"{path} does not exist (video devices present: {present})", remedy)]


def examine_realsense(config: RigConfig, name: str) -> list[Finding]:
    """Check that librealsense lists the camera, or that its recording is there; opens none, a run may be using it."""
    from rig.hardware.cameras.realsense import ANY, RECORDINGS, why_unusable

    topic, wanted = f"rig's camera {name}", str(config.cameras[name].device)
    if Path(wanted).suffix in RECORDINGS:
        return [_recording(topic, Path(wanted))]
    try:
        rs: Any = importlib.import_module("pyrealsense2")
    except ImportError as why:
        return [Finding(topic, "missing", *why_unusable(why))]
    serials = [device.get_info(rs.camera_info.serial_number) for device in rs.context().query_devices()]
    if wanted in serials or (wanted == ANY and serials):
        return [Finding(topic, "ok", f"RealSense {wanted}")]
    present = ", ".join(serials) or "none"
    return [Finding(topic, "missing", f"no RealSense {wanted} (present: {present})", f"{PLUG_IN}, or correct `device`")]


def _recording(topic: str, path: Path) -> Finding:
    if path.exists():
        return Finding(topic, "ok", f"recording {path}")
    return Finding(topic, "missing", f"recording {path} does not exist", "correct `device` in the rig's file")
