"""Lines of the serial pressure controller: a body in ASCII, `*`, and the CRC-16/XMODEM of the body in hexadecimal.

docs/reference/serial-protocol.md describes every line; docs/examples/firmware is the other side. Pressures are gauge,
in whole pascals.
"""

from __future__ import annotations

import binascii
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

VERSION = 1
SEQUENCES = 1 << 16
LONGEST = 256
"""Bytes without a line feed after which the rest is dropped."""
_NUMBER = re.compile(r"-?[0-9]{1,10}")


class ControllerState(IntEnum):
    """State of the controller."""

    VENTED = 0
    DRIVEN = 1
    SILENT = 2
    """It has vented by itself, because no command came."""


@dataclass(frozen=True)
class Identity:
    """Answer to `Q`: channels, limits of set-points, vent level [Pa], and the silence after which it vents [us]."""

    channels: int
    lowest_pa: int
    highest_pa: int
    vent_pa: int
    silence_us: int


@dataclass(frozen=True)
class SerialSample:
    """A sample: its number, the controller's time [us], state, lines it has rejected, pressures."""

    count: int
    t_us: int
    state: ControllerState
    rejected: int
    measured_pa: tuple[int, ...]


@dataclass(frozen=True)
class Acknowledgement:
    """A command that was obeyed: its sequence number, the state, and the set-points that now hold."""

    sequence: int
    state: ControllerState
    setpoint_pa: tuple[int, ...]


Answer = Identity | SerialSample | Acknowledgement


def encoded(body: str) -> bytes:
    """A line to send."""
    return f"{body}*{binascii.crc_hqx(body.encode('ascii'), 0):04X}\n".encode("ascii")


def drive(sequence: int, setpoint_pa: Sequence[int]) -> bytes:
    """Set every channel; also the heartbeat."""
    return encoded(" ".join(["W", str(sequence), *map(str, setpoint_pa)]))


def decoded(line: bytes) -> Answer | None:
    """The answer in a line without its line feed; None if its checksum or its content is wrong."""
    body, star, stated = line.rpartition(b"*")
    try:
        if not star or len(stated) != 4 or int(stated, 16) != binascii.crc_hqx(body, 0):
            return None
        kind, *words = body.decode("ascii").split(" ")
        if kind == "I":
            name, *words = words
            version, *limits = map(_number, words)
            return Identity(*limits) if (name, version) == ("softrig", VERSION) else None
        numbers = [_number(word) for word in words]
        if kind == "S":
            count, t_us, state, rejected, *pressures = numbers
            return SerialSample(count, t_us, ControllerState(state), rejected, tuple(pressures))
        if kind == "A":
            sequence, state, *pressures = numbers
            return Acknowledgement(sequence, ControllerState(state), tuple(pressures))
    except (ValueError, TypeError):
        return None
    return None


def _number(word: str) -> int:
    """The number of a word; `int` would also take signs, underscores and any number of digits."""
    if not _NUMBER.fullmatch(word):
        raise ValueError(f"{word!r} is no whole number of at most ten digits")
    return int(word)


class LineReader:
    """Splits received bytes into answers; `rejected` counts lines that are not valid."""

    def __init__(self) -> None:
        self._rest = b""
        self.rejected = 0

    def answers(self, received: bytes) -> list[Answer]:
        """The answers in what has been received since the last call."""
        *lines, self._rest = (self._rest + received).split(b"\n")
        if len(self._rest) > LONGEST:
            self._rest = self._rest[-1:]
        found = [decoded(line) for line in lines]
        self.rejected += found.count(None)
        return [answer for answer in found if answer is not None]
