"""The datagram of the UDP tracker: 256 bytes, little endian; see docs/reference/tracker-datagram.md."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np

from model.arrays import Array

MAGIC, VERSION = b"SRTP", 1
SEES = 1
"""Flag: the tracker sees the body."""
_BODY = struct.Struct("<4sHHQq3d4d21df")
_CRC = struct.Struct("<I")
BYTES = _BODY.size + _CRC.size
_UPPER = np.triu_indices(6)
UNIT_TOLERANCE = 1e-3
"""Largest difference of the quaternion's norm from 1."""


LARGEST_M, LARGEST_STD = 1e3, 1e2
"""Farthest coordinate [m], and largest standard deviation [m, rad] of a pose that says anything."""


class DatagramError(Exception):
    """The bytes are no datagram of this version, or were damaged."""


@dataclass(frozen=True)
class Datagram:
    """One message: `position_m` (3,), `quaternion` (w, x, y, z) and `covariance` (6, 6) in the tracker's frame."""

    sequence: int
    sent_ns: int
    sees: bool
    position_m: Array
    quaternion: Array
    covariance: Array
    quality: float = 1.0

    @property
    def plausible(self) -> bool:
        """False for numbers that no pose has."""
        if not self.sees:
            return True
        bounds = (
            (self.position_m, LARGEST_M),
            (self.quaternion, 1 + UNIT_TOLERANCE),
            (self.covariance, LARGEST_STD**2),
        )
        if not all(np.all(np.abs(numbers) <= bound) for numbers, bound in bounds):  # NaN is within no bound
            return False
        unit = abs(float(np.linalg.norm(self.quaternion)) - 1) <= UNIT_TOLERANCE
        smallest = float(np.linalg.eigvalsh(self.covariance)[0])
        return unit and smallest >= -1e-9 * float(np.trace(self.covariance)) and bool(np.diag(self.covariance).all())


def encode(message: Datagram) -> bytes:
    """Return the bytes of a datagram."""
    body = _BODY.pack(
        MAGIC, VERSION, SEES if message.sees else 0, message.sequence, message.sent_ns,
        *message.position_m, *message.quaternion, *message.covariance[_UPPER], message.quality,
    )  # fmt: skip
    return body + _CRC.pack(zlib.crc32(body))


def decode(data: bytes) -> Datagram:
    """Return the message in the bytes of a datagram. Raises DatagramError: wrong size, begin, version or CRC."""
    if len(data) != BYTES:
        raise DatagramError(f"{len(data)} bytes, not {BYTES}")
    body, (crc,) = data[: _BODY.size], _CRC.unpack(data[_BODY.size :])
    if zlib.crc32(body) != crc:
        raise DatagramError("the CRC does not fit")
    magic, version, flags, sequence, sent_ns, *numbers = _BODY.unpack(body)
    if magic != MAGIC or version != VERSION:
        raise DatagramError(f"begins with {magic!r}, version {version}, not {MAGIC!r}, version {VERSION}")
    covariance = np.zeros((6, 6))
    covariance[_UPPER] = numbers[7:28]
    covariance = covariance + np.triu(covariance, 1).T
    values = np.array(numbers[:7])
    return Datagram(sequence, sent_ns, bool(flags & SEES), values[:3], values[3:], covariance, numbers[28])
