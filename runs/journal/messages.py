"""What the messages of a journal mean: rows and pictures as ROS 1 binary, the rest as JSON.

ROS 1 messages of fixed size are packed little-endian, as NumPy's rows are: so a row is its own message, and viewers
that read MCAP (Foxglove, PlotJuggler) plot a journal as it is. The channel's metadata holds the exact dtype.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from runs.records import Event, ImageAnnotations, Picture, RunFooter, RunHeader

if TYPE_CHECKING:
    from pydantic import TypeAdapter

T = TypeVar("T", RunHeader, RunFooter, Event)

HEADER, FOOTER, EVENTS, PICTURES, MARKS = 1, 2, 3, 6, 8
"""Channel numbers, the same in every journal; `runs.journal.row_kinds` has those of rows."""
TOPICS = {
    HEADER: "/header",
    FOOTER: "/footer",
    EVENTS: "/events",
    PICTURES: "/pictures",
    MARKS: "/marks",
}
_ROS_TYPES = {"<i8": "int64", "<i4": "int32", "<f8": "float64", "<f4": "float32"}
_STAMP = struct.Struct("<III")
_LENGTH = struct.Struct("<I")
_FRAME = struct.Struct("<q")
_ADAPTERS: dict[Any, TypeAdapter[Any]] = {}
"""Building one takes longer than reading a message."""

PICTURE_DEFINITION = f"""std_msgs/Header header
string format
uint8[] data
{"=" * 80}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""

MARKS_DEFINITION = """int64 frame
string camera
float32[] corners_px
float32[] tip_px
float32[] model_px
float32[] backbone_px
"""
"""Of the picture with this number by this camera; u, v, u, v, .. each."""


def to_json(value: RunHeader | RunFooter | Event) -> bytes:
    """Return a header, footer or event as JSON."""
    return json.dumps(_plain(asdict(value)), ensure_ascii=False).encode(errors="replace")


def _plain(value: Any) -> Any:
    """JSON has no number for what is not finite: it is written as text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value


def from_json(kind: type[T], data: bytes) -> T:
    """Return what `to_json` was given; `ValueError` where the data is no such thing."""
    from pydantic import TypeAdapter  # an archive is read without it

    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    value: T = _ADAPTERS[kind].validate_json(data)
    return value


def row_definition(row: np.dtype[np.void]) -> str:
    """Return the ROS 1 message definition of a row."""
    lines = []
    for name in row.names or ():
        base, shape = row[name].base, row[name].shape
        count = f"[{math.prod(shape)}]" if shape else ""
        lines.append(f"{_ROS_TYPES[base.str]}{count} {name}")
    return "\n".join(lines) + "\n"


def dtype_to_json(row: np.dtype[np.void]) -> str:
    """Return a row's dtype as JSON: [name, type, shape] of each field."""
    return json.dumps([[name, row[name].base.str, list(row[name].shape)] for name in row.names or ()])


def dtype_from_json(text: str) -> np.dtype[np.void]:
    """Return what `dtype_to_json` was given."""
    return np.dtype([(name, kind, tuple(shape)) for name, kind, shape in json.loads(text)])


def picture_to_bytes(picture: Picture, utc_ns: int) -> bytes:
    """Return a picture as a ROS 1 `sensor_msgs/CompressedImage`; `frame` goes into `seq`."""
    seconds, nanoseconds = divmod(utc_ns, 1_000_000_000)
    camera, encoding = picture.camera.encode(), picture.encoding.encode()
    return b"".join(
        (
            _STAMP.pack(picture.frame & 0xFFFFFFFF, seconds & 0xFFFFFFFF, nanoseconds),
            _LENGTH.pack(len(camera)),
            camera,
            _LENGTH.pack(len(encoding)),
            encoding,
            _LENGTH.pack(len(picture.data)),
            picture.data,
        )
    )


def picture_from_bytes(body: bytes) -> tuple[int, str, str, int]:
    """Return frame, camera, encoding, and where the encoded image begins in the message."""
    frame, _, _ = _STAMP.unpack_from(body, 0)
    position = _STAMP.size
    words = []
    for _ in range(2):
        (length,) = _LENGTH.unpack_from(body, position)
        position += _LENGTH.size
        words.append(body[position : position + length].decode())
        position += length
    return frame, words[0], words[1], position + _LENGTH.size


def marks_to_bytes(picture: Picture) -> bytes:
    """Return what was seen in a picture as the ROS 1 message of `MARKS_DEFINITION`."""
    camera, marks = picture.camera.encode(), picture.marks
    parts = [_FRAME.pack(picture.frame), _LENGTH.pack(len(camera)), camera]
    for points in (marks.corners_px, marks.tip_px, marks.model_px, marks.backbone_px):
        parts += (_LENGTH.pack(points.size), points.astype("<f4").tobytes())
    return b"".join(parts)


def marks_from_bytes(body: bytes) -> tuple[int, str, ImageAnnotations]:
    """Return frame, camera and marks; `ValueError` where the message is not whole."""
    (frame,) = _FRAME.unpack_from(body, 0)
    (length,) = _LENGTH.unpack_from(body, _FRAME.size)
    position = _FRAME.size + _LENGTH.size + length
    camera = body[position - length : position].decode()
    points = []
    for _ in range(4):
        (length,) = _LENGTH.unpack_from(body, position)
        position += _LENGTH.size
        points.append(np.frombuffer(body, "<f4", length, position))
        position += 4 * length
    return frame, camera, ImageAnnotations.of(*points)
