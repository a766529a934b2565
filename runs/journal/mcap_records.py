"""MCAP blocks: messages framed with a checksum, and found again in a damaged file.

A block is one MCAP chunk record, uncompressed, handed to the kernel in one write. Chunks carry a CRC-32, bare
messages do not: so a reader detects a flipped bit, and finds the next intact block after damage.
MCAP's records are specified at https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, McapRecord
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<BQQQQIIQ")
"""Opcode, length, first time, last time, size of the content, its CRC-32, length of the compression's name, size."""
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time."""
_CHUNK_FIELDS = _CHUNK.size - _RECORD.size
_ALLOWED_BETWEEN = {Opcode.HEADER: 256, Opcode.DATA_END: 4, Opcode.FOOTER: 20}
"""Records that may stand between blocks, with their largest accepted lengths."""


@dataclass(frozen=True)
class JournalDamage:
    """A stretch of a journal that could not be read."""

    offset: int
    size: int
    reason: str

    def __str__(self) -> str:
        return f"{self.size} bytes at {self.offset}: {self.reason}"


def encode(*records: McapRecord) -> bytes:
    """Return MCAP records as bytes."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def opening() -> bytes:
    """Return what an MCAP file begins with."""
    return MAGIC + encode(Header(profile="", library="softrig"))


def ending() -> bytes:
    """Return what a complete MCAP file ends with."""
    return encode(DataEnd(data_section_crc=0), Footer(summary_start=0, summary_offset_start=0, summary_crc=0)) + MAGIC


def block(content: bytes, first_ns: int, last_ns: int) -> bytes:
    """Frame records as one block; the times are those of its first and last message."""
    size = len(content)
    head = _CHUNK.pack(
        Opcode.CHUNK, _CHUNK_FIELDS + size, first_ns, last_ns, size, zlib.crc32(content), 0, size
    )  # fmt: skip
    return head + content


def framed(row: np.dtype[np.void]) -> np.dtype[np.void]:
    """Return the dtype of an MCAP message record whose payload is one row."""
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_ns", "<u8"),
            ("publish_ns", "<u8"),
            ("row", row),
        ]
    )


def frame_rows(
    rows: NDArray[np.void], form: np.dtype[np.void], channel: int, sequence: int, log_ns: NDArray[np.int64]
) -> bytes:
    """Return rows (n,) as n message records; `form` is `framed(rows.dtype)`, `log_ns` (n,) their times."""
    records = np.empty(len(rows), form)
    records["opcode"] = Opcode.MESSAGE
    records["length"] = form.itemsize - _RECORD.size
    records["channel"] = channel
    records["sequence"] = np.arange(sequence, sequence + len(rows)) & 0xFFFFFFFF
    records["log_ns"] = log_ns
    records["publish_ns"] = log_ns
    records["row"] = rows
    return records.tobytes()


def framed_rows(content: memoryview, form: np.dtype[np.void], channel: int) -> int:
    """Return how many rows a block holds that has nothing but messages of this form and channel, else 0."""
    if len(content) == 0 or len(content) % form.itemsize:
        return 0
    records: NDArray[np.void] = np.frombuffer(content, form)
    sound = (
        (records["opcode"] == Opcode.MESSAGE)
        & (records["length"] == form.itemsize - _RECORD.size)
        & (records["channel"] == channel)
    )
    return len(records) if sound.all() else 0


def decode_channel(body: memoryview) -> Channel:
    """Return the channel in the body of its record."""
    channel: Channel = Channel.read(ReadDataStream(BytesIO(body.tobytes())))
    return channel


def decode_message(body: memoryview) -> tuple[int, int, memoryview]:
    """Return channel number, time and payload of the body of a message."""
    channel, _, log_ns, _ = _MESSAGE.unpack_from(body, 0)
    return channel, log_ns, body[_MESSAGE.size :]


def message_at(data: memoryview, position: int) -> tuple[int, int, memoryview]:
    """Return channel number, time and payload of the message whose record begins here."""
    _, length = _RECORD.unpack_from(data, position)
    begin = position + _RECORD.size
    return decode_message(data[begin : begin + length])


@dataclass(frozen=True)
class JournalBlock:
    """The checked content of one block: MCAP records."""

    offset: int
    content: memoryview

    @property
    def begin(self) -> int:
        """Where the content begins in the file."""
        return self.offset + _CHUNK.size

    def records(self) -> Iterator[tuple[int, int, memoryview]]:
        """Yield (opcode, where it begins in the file, body) of each record."""
        position = 0
        while position < len(self.content):
            opcode, length = _RECORD.unpack_from(self.content, position)
            body = position + _RECORD.size
            yield opcode, self.begin + position, self.content[body : body + length]
            position = body + length


def scan(data: memoryview) -> Iterator[JournalBlock | JournalDamage]:
    """Yield the blocks of a journal, and what of it could not be read, in order."""
    size = len(data)
    position = len(MAGIC)
    if data[:position].tobytes() != MAGIC:
        yield JournalDamage(0, min(size, position), "the file does not begin like a journal")
    while position < size:
        end = _record_end(data, position)
        if end is None:
            following = _next_chunk(data, position + 1)
            stop = size if following is None else following
            reason = "torn or foreign" if following is None else "damaged"
            yield JournalDamage(position, stop - position, reason)
            position = stop
            continue
        if data[position] == Opcode.CHUNK:
            content = data[position + _CHUNK.size : end]
            if zlib.crc32(content) == _CHUNK.unpack_from(data, position)[5]:
                yield JournalBlock(position, content)
            else:
                yield JournalDamage(position, end - position, "wrong checksum")
        position = end


def _record_end(data: memoryview, position: int) -> int | None:
    """Return where the record at this position ends; None if there is no valid record."""
    size = len(data)
    if size - position == len(MAGIC) and data[position:].tobytes() == MAGIC:
        return size
    if position + _RECORD.size > size:
        return None
    opcode, length = _RECORD.unpack_from(data, position)
    end = position + _RECORD.size + int(length)
    if end > size:
        return None
    if opcode == Opcode.CHUNK:
        return end if _is_chunk(data, position) else None
    return end if length <= _ALLOWED_BETWEEN.get(opcode, -1) else None


def _is_chunk(data: memoryview, position: int) -> bool:
    """Return whether the lengths in a possible block agree with each other and with the file."""
    if position + _CHUNK.size > len(data):
        return False
    opcode, length, _, _, size, _, name, again = _CHUNK.unpack_from(data, position)
    return bool(
        opcode == Opcode.CHUNK
        and name == 0
        and size == again == length - _CHUNK_FIELDS
        and position + _CHUNK.size + size <= len(data)
    )


def _next_chunk(data: memoryview, start: int) -> int | None:
    """Return where the next block with a correct checksum begins."""
    stretch = 1 << 20
    for low in range(start, len(data), stretch):
        for found in np.flatnonzero(np.frombuffer(data[low : low + stretch], np.uint8) == Opcode.CHUNK):
            position = low + int(found)
            if _is_chunk(data, position):
                _, _, _, _, size, crc, _, _ = _CHUNK.unpack_from(data, position)
                begin = position + _CHUNK.size
                if zlib.crc32(data[begin : begin + size]) == crc:
                    return position
    return None
