"""The journal of a run: append-only, whole up to its last write whatever happens to the process.

MCAP with one checked block per call, written past every buffer of the process: what a call returned from survives
kill -9; what is older than a second survives a power cut (`runs.journal.append_only_file`, which also describes a
stalled disk). The first block (schemas and header) is written twice, because without it nothing else can be read.
"""

from __future__ import annotations

import mmap
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema
from numpy.typing import NDArray

from runs.journal import mcap_records, messages
from runs.journal.append_only_file import BufferedFile, DiskFile, JournalError
from runs.journal.mcap_records import JournalBlock, JournalDamage
from runs.journal.messages import EVENTS, FOOTER, HEADER, MARKS, PICTURES
from runs.journal.row_kinds import ROW_KINDS, RowKind
from runs.journal.stored_rows import Index, StoredPictures, StoredRows
from runs.records import Event, Picture, RunFooter, RunHeader

SUFFIX = ".mcap"


class JournalWriter:
    """Writes one run's journal. For one thread; the file is locked (flock) while it is open.

    Every call raises `JournalError` if the disk is full, fails or, in a live run, stalls for too long.
    """

    def __init__(
        self, path: Path | str, header: RunHeader, *, live: bool = False, patience_s: float | None = None
    ) -> None:
        """Create the file, which must not exist, and write the header.

        A `live` run does not wait for a disk that stalls for less than `patience_s` (default 10 s); other runs wait.
        """
        self.path = Path(path)
        self._kinds = {kind.name: _FramedRows(kind, header) for kind in ROW_KINDS}
        self._utc_minus_t_ns = header.started_utc_ns - header.started_t_ns
        self.newest_t_ns = header.started_t_ns
        first = block_of_header(header)
        file = DiskFile(self.path, mcap_records.opening() + first + first)
        self._file = BufferedFile(file, patience_s) if live else file

    @property
    def stalled_s(self) -> float:
        """Age [s] of the oldest record that is not yet on the disk; 0 if there is none."""
        return self._file.stalled_s

    def samples(self, rows: NDArray[np.void]) -> None:
        """Append control cycles: `sample_dtype` rows (n,)."""
        self._append("samples", rows)

    def observations(self, rows: NDArray[np.void]) -> None:
        """Append camera frames: `observation_dtype` rows (n,)."""
        self._append("observations", rows)

    def adaptations(self, rows: NDArray[np.void]) -> None:
        """Append what the recursive estimator found: `adaptation_dtype` rows (n,)."""
        self._append("adaptations", rows)

    def plans(self, rows: NDArray[np.void]) -> None:
        """Append plans of the tip controller: `tip_control_dtype` rows (n,)."""
        self._append("plans", rows)

    def streamed(self, rows: NDArray[np.void]) -> None:
        """Append set-points of another program: `streamed_dtype` rows (n,)."""
        self._append("streamed", rows)

    def pulses(self, rows: NDArray[np.void]) -> None:
        """Append pulses of the camera trigger: `pulse_dtype` rows (n,)."""
        self._append("pulses", rows)

    def picture(self, picture: Picture) -> None:
        """Append an encoded picture and what was seen in it, both or neither."""
        utc_ns = picture.t_ns + self._utc_minus_t_ns
        content = mcap_records.encode(
            Message(MARKS, utc_ns, messages.marks_to_bytes(picture), utc_ns, 0),
            Message(PICTURES, utc_ns, messages.picture_to_bytes(picture, utc_ns), utc_ns, 0),
        )
        self._file.append(mcap_records.block(content, utc_ns, utc_ns))

    def event(self, event: Event) -> None:
        """Append an event."""
        utc_ns = event.t_ns + self._utc_minus_t_ns
        self.newest_t_ns = max(self.newest_t_ns, event.t_ns)
        content = mcap_records.encode(Message(EVENTS, utc_ns, messages.to_json(event), utc_ns, 0))
        self._file.append(mcap_records.block(content, utc_ns, utc_ns))

    def wait_until_synced(self, timeout_s: float) -> bool:
        """Wait until all records are on the disk; False on timeout."""
        return self._file.wait_until_synced(timeout_s)

    def close(self, footer: RunFooter) -> None:
        """Write how the run ended, and close. Closes the file even if there is no space for the footer."""
        utc_ns = footer.t_ns + self._utc_minus_t_ns
        content = mcap_records.encode(Message(FOOTER, utc_ns, messages.to_json(footer), utc_ns, 0))
        self._file.close(mcap_records.block(content, utc_ns, utc_ns) + mcap_records.ending())

    def _append(self, name: str, rows: NDArray[np.void]) -> None:
        if len(rows) == 0:
            return
        kind = self._kinds[name]
        if rows.dtype != kind.form["row"]:
            raise TypeError(f"rows of {rows.dtype}, expected {kind.form['row']}")
        log_ns = rows["t_ns"] + self._utc_minus_t_ns
        content = mcap_records.frame_rows(rows, kind.form, kind.channel, kind.sequence, log_ns)
        kind.sequence += len(rows)
        self.newest_t_ns = max(self.newest_t_ns, int(rows["t_ns"][-1]))
        self._file.append(mcap_records.block(content, int(log_ns[0]), int(log_ns[-1])))


class _FramedRows:
    """How one kind of row is framed, and how many there were."""

    def __init__(self, kind: RowKind, header: RunHeader) -> None:
        self.channel = kind.channel
        self.form = mcap_records.framed(kind.dtype(header))
        self.sequence = 0


def block_of_header(header: RunHeader) -> bytes:
    """Return the first block of a journal: schemas, channels (those of rows that the run has) and the header."""
    json: tuple[str, bytes, str, dict[str, str]] = ("jsonschema", b'{"type": "object"}', "json", {})
    kinds = {
        HEADER: json,
        FOOTER: json,
        EVENTS: json,
        PICTURES: ("ros1msg", messages.PICTURE_DEFINITION.encode(), "ros1", {}),
        MARKS: ("ros1msg", messages.MARKS_DEFINITION.encode(), "ros1", {}),
    }
    topics = messages.TOPICS.copy()
    for kind in ROW_KINDS:
        if kind.recorded(header):
            row = kind.dtype(header)
            metadata = {"dtype": messages.dtype_to_json(row)}
            kinds[kind.channel] = ("ros1msg", messages.row_definition(row).encode(), "ros1", metadata)
            topics[kind.channel] = kind.topic
    names = {PICTURES: "sensor_msgs/CompressedImage"}
    records: list[Schema | Channel | Message] = []
    for channel, (schema_encoding, definition, encoding, metadata) in kinds.items():
        name = names.get(channel, f"softrig{topics[channel]}")
        records.append(Schema(channel, definition, schema_encoding, name))
        records.append(Channel(channel, topics[channel], encoding, metadata, channel))
    utc_ns = header.started_utc_ns
    records.append(Message(HEADER, utc_ns, messages.to_json(header), utc_ns, 0))
    return mcap_records.block(mcap_records.encode(*records), utc_ns, utc_ns)


@dataclass(frozen=True)
class Journal:
    """What a journal holds. `footer` is None if the run was cut off; `damage` lists unreadable parts.

    Rows and pictures stay in the file until a slice of them is taken.
    """

    header: RunHeader
    footer: RunFooter | None
    samples: StoredRows
    observations: StoredRows
    adaptations: StoredRows
    plans: StoredRows
    streamed: StoredRows
    pulses: StoredRows
    events: tuple[Event, ...]
    pictures: StoredPictures
    damage: tuple[JournalDamage, ...]


def read(path: Path | str) -> Journal:
    """Read the intact parts of a journal; `JournalError` if the header is not readable."""
    try:
        with Path(path).open("rb") as file:
            empty = os.fstat(file.fileno()).st_size == 0
            data = memoryview(b"" if empty else mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except OSError as fault:
        raise JournalError(f"cannot read {path}: {fault.strerror}") from fault
    contents = _Contents(data)
    for piece in mcap_records.scan(data):
        if isinstance(piece, JournalDamage):
            contents.damage.append(piece)
            continue
        try:
            contents.take(piece)
        except (ValueError, KeyError, TypeError, struct.error, RecursionError) as fault:
            size = len(piece.content)
            contents.damage.append(JournalDamage(piece.offset, size, f"not understood ({type(fault).__name__})"))
    if contents.header is None:
        raise JournalError(f"{path} is not a journal, or its header is lost")
    return contents.journal(contents.header)


class _Contents:
    """Collects the contents of a journal block by block."""

    def __init__(self, data: memoryview) -> None:
        self.header: RunHeader | None = None
        self.footer: RunFooter | None = None
        self.data = data
        self.stored: dict[int, np.dtype[np.void]] = {}
        self.rows = {kind.channel: Index() for kind in ROW_KINDS}
        self.events: list[Event] = []
        self.pictures = StoredPictures(data)
        self.damage: list[JournalDamage] = []

    def take(self, piece: JournalBlock) -> None:
        for channel, stored in self.stored.items():
            form = mcap_records.framed(stored)
            if rows := mcap_records.framed_rows(piece.content, form, channel):
                self.rows[channel].add(piece.begin + (form.itemsize - stored.itemsize), rows)
                return
        for opcode, position, body in piece.records():
            if opcode == Opcode.CHANNEL:
                self._channel(mcap_records.decode_channel(body))
            elif opcode == Opcode.MESSAGE:
                channel, _, payload = mcap_records.decode_message(body)
                self._message(channel, position, payload)

    def _channel(self, channel: Channel) -> None:
        if "dtype" in channel.metadata:
            # The first block is written twice; rows of one channel are all of one dtype.
            self.stored.setdefault(channel.id, messages.dtype_from_json(channel.metadata["dtype"]))

    def _message(self, channel: int, position: int, payload: memoryview) -> None:
        if channel == HEADER:
            self.header = messages.from_json(RunHeader, payload.tobytes())
            self.pictures.utc_minus_t_ns = self.header.started_utc_ns - self.header.started_t_ns
        elif channel == FOOTER:
            self.footer = messages.from_json(RunFooter, payload.tobytes())
        elif channel == EVENTS:
            self.events.append(messages.from_json(Event, payload.tobytes()))
        elif channel == MARKS:
            self.pictures.mark(position)
        elif channel == PICTURES:
            self.pictures.picture(position)

    def journal(self, header: RunHeader) -> Journal:
        def rows(kind: RowKind) -> StoredRows:
            now = kind.dtype(header)
            return StoredRows(self.data, self.stored.get(kind.channel, now), now, self.rows[kind.channel])

        return Journal(
            header=header,
            footer=self.footer,
            events=tuple(self.events),
            pictures=self.pictures,
            damage=tuple(self.damage),
            **{kind.name: rows(kind) for kind in ROW_KINDS},
        )
