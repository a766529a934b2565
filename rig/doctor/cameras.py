"""Checks of the machine's cameras."""

from __future__ import annotations

import fcntl
import os
import struct
from pathlib import Path

from rig.config.drivers import Finding
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
