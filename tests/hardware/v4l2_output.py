"""The writing end of v4l2loopback."""

from __future__ import annotations

import fcntl
import os
import struct

_OUTPUT = 2  # V4L2_BUF_TYPE_VIDEO_OUTPUT
_FIELD_NONE = 1
_SRGB = 8
_FORMAT_BYTES = 208  # struct v4l2_format on 64 bits: the type, padding, and a union of 200 bytes
_SET_FORMAT = (3 << 30) | (_FORMAT_BYTES << 16) | (ord("V") << 8) | 5


def open_output(device: str, width_px: int, height_px: int) -> int:
    """Open a device for YUYV pictures of that size; each `os.write` to the descriptor plays one."""
    node = os.open(device, os.O_RDWR)
    fourcc = int.from_bytes(b"YUYV", "little")
    pixels = struct.pack("<7I", width_px, height_px, fourcc, _FIELD_NONE, 2 * width_px, 2 * width_px * height_px, _SRGB)
    fcntl.ioctl(node, _SET_FORMAT, bytearray(struct.pack("<2I", _OUTPUT, 0) + pixels.ljust(200, b"\0")))
    return node
