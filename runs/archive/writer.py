"""The archive of a run: a journal turned into NeXus HDF5 with its digest, whole or not at all.

Written under a temporary name, read back from the disk by its digest, then renamed. Rows and pictures go from the
journal into the archive some thousand at a time: a long run needs no more memory than a short one.
"""

from __future__ import annotations

import io
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5s, h5t

from runs.archive import digest, layout
from runs.archive.digest import ArchiveError as ArchiveError
from runs.archive.digest import DamagedArchiveError
from runs.archive.fields import CHUNK_ROWS, ComputedColumn, Field, Group, RowTable, row_chunks
from runs.journal import journal
from runs.journal.append_only_file import ARCHIVE_TO_JOURNAL, NO_ROOM, JournalError, lock

SUFFIX = ".h5"
PART = ".h5.part"
"""End of the name while the archive is being written."""
_MARGIN_BYTES = 4 << 20
_SMALLEST_COMPRESSED = 512
_PICTURE_ROWS = 64
"""Pictures written at once."""


class ArchiveInUseError(ArchiveError):
    """A running process still writes the journal."""


def finalise(journal_path: Path | str) -> Path:
    """Make an archive beside a journal and return its path; the journal is kept.

    A journal without a footer gives an archive with status
    `recovered`. An existing archive is replaced. Raises `ArchiveError` or `JournalError`.
    """
    source = Path(journal_path)
    target = source.with_suffix(SUFFIX)
    with locked(source):
        content = journal.read(source)
        write(content, target, _MARGIN_BYTES + int(ARCHIVE_TO_JOURNAL * source.stat().st_size))
    return target


def write(content: journal.Journal, target: Path, most_bytes: int) -> None:
    """Write an archive of at most this size under a temporary name, check it, and give it its name."""
    part = target.with_name(target.name.removesuffix(SUFFIX) + PART)
    try:
        _take_room(part, most_bytes)
        ended_utc_ns = content.header.started_utc_ns + layout.end_t_ns(content) - content.header.started_t_ns
        _write(part, target.name, layout.utc(ended_utc_ns), layout.groups(content))
        digest.seal(part)
        _sync(part)
        digest.checked(part)
        part.replace(target)
        _sync(target.parent)
    except DamagedArchiveError:
        part.unlink(missing_ok=True)
        raise ArchiveError(f"{target}: what was read back is not what was written; is the disk sound?") from None
    except (OSError, RuntimeError, ValueError) as fault:
        # HDF5 reports errors as any of these, some only on close.
        with suppress(OSError):
            part.unlink(missing_ok=True)
        number = fault.errno if isinstance(fault, OSError) else None
        full = number in NO_ROOM or any(os.strerror(code) in str(fault) for code in NO_ROOM)
        said = fault.strerror if isinstance(fault, OSError) and fault.strerror else str(fault)
        reason = "the disk is full" if full else said.replace(str(part), str(target))
        raise ArchiveError(f"cannot write {target}: {reason}; the journal holds everything") from fault


@contextmanager
def locked(source: Path) -> Iterator[None]:
    """Lock a journal during finalisation; `ArchiveInUseError` if its writer is still running."""
    try:
        handle = os.open(source, os.O_RDONLY)
    except OSError as fault:
        raise JournalError(f"cannot read {source}: {fault.strerror}") from fault
    try:
        try:
            lock(handle)
        except BlockingIOError as fault:
            raise ArchiveInUseError(f"{source} is being written by another process") from fault
        yield
    finally:
        os.close(handle)


def _take_room(part: Path, size: int) -> None:
    """Make an empty HDF5 file that holds room for this size; unused space is released on close.

    Raises `OSError` if there is not enough space: HDF5 itself prints tracebacks or crashes on a full disk.
    """
    empty = io.BytesIO()
    h5py.File(empty, "w").close()
    part.unlink(missing_ok=True)
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    try:
        os.posix_fallocate(handle, 0, size)
        os.pwrite(handle, empty.getbuffer(), 0)
    finally:
        os.close(handle)


def _write(part: Path, name: str, time: str, groups: tuple[Group, ...]) -> None:
    """Write every group. A file of one journal is the same, byte for byte, whenever it is written."""
    # No chunk cache per open dataset: only whole chunks are written.
    with h5py.File(part, "r+", rdcc_nbytes=0) as file:
        written: list[_Dataset] = []
        for group in groups:
            node = file.require_group(group.path)
            node.attrs["NX_class"] = group.nx_class
            if group.about:
                node.attrs["comment"] = group.about
            if group.default:
                node.attrs["default"] = group.default
            if group.signal:
                node.attrs["signal"] = group.signal
                node.attrs["axes"] = list(group.axes)
            written += [_Dataset(node, item) for item in group.fields]
            _attach(node, group)
        _fill(written)
        file.attrs.update(
            NX_class="NXroot",
            default="entry",
            creator="softrig",
            layout_version=layout.VERSION,
            file_name=name,
            file_time=time,
            HDF5_Version=h5py.version.hdf5_version,
            h5py_version=h5py.version.version,
        )


class _Dataset:
    """One dataset of an archive."""

    def __init__(self, node: h5py.Group, item: Field) -> None:
        self.column = item.value if isinstance(item.value, ComputedColumn) else None
        now = item.sample
        shape: tuple[int, ...] = np.shape(now) if self.column is None else (len(self.column.table),)
        storage: dict[str, Any] = {}
        kind: Any
        if item.pictures:
            self._kind, kind = "bytes", h5py.vlen_dtype(np.uint8)
        elif isinstance(now, str | list):
            self._kind, kind = "str", h5py.string_dtype()
        else:
            numbers = np.asarray(now)
            self._kind, kind = "numbers", numbers.dtype
            shape = (*shape[:1], *numbers.shape[1:])
            storage = _storage(shape, kind.itemsize)
        self._node = node.create_dataset(item.name, shape, kind, **storage)
        attributes = (
            ("units", item.units),
            ("description", item.about),
            ("source", item.source),
            ("uncertainty", item.uncertainty),
        )
        for name, attribute in attributes:
            if attribute not in ("", None):
                self._node.attrs[name] = attribute
        if self.column is None:
            self.put(0, now)

    def put(self, low: int, values: Any) -> None:
        """Write the rows from `low` on, or the one value that there is."""
        single = self._node.shape == ()
        rows = () if single else slice(low, low + len(values))
        if self._kind == "bytes":
            for first in range(0, len(values), _PICTURE_ROWS):
                self._put_pictures(low + first, values[first : first + _PICTURE_ROWS])
        elif self._kind == "str":
            # HDF5 ends a text at its first NUL.
            words = [word.replace("\0", "\N{SYMBOL FOR NULL}") for word in ([values] if single else values)]
            if words:
                self._node[rows] = words[0] if single else np.array(words, dtype=object)
        else:
            numbers = np.asarray(values)
            if numbers.size:
                self._node[rows] = numbers

    def _put_pictures(self, low: int, pictures: Sequence[memoryview]) -> None:
        """Write some pictures in one call; h5py's own assignment would take those of one length for a matrix."""
        encoded = np.empty(len(pictures), self._node.dtype)
        for index, data in enumerate(pictures):
            encoded[index] = np.frombuffer(data, np.uint8)
        rows = self._node.id.get_space()
        rows.select_hyperslab((low,), encoded.shape)
        self._node.id.write(h5s.create_simple(encoded.shape), rows, encoded, h5t.py_create(encoded.dtype))


def _fill(datasets: list[_Dataset]) -> None:
    """Write the columns: reads each table once, in chunks of rows."""
    tables: dict[int, tuple[RowTable, list[tuple[_Dataset, ComputedColumn]]]] = {}
    for dataset in datasets:
        if (column := dataset.column) is not None:
            tables.setdefault(id(column.table), (column.table, []))[1].append((dataset, column))
    for table, columns in tables.values():
        for number, rows in enumerate(row_chunks(table)):
            for dataset, column in columns:
                dataset.put(number * CHUNK_ROWS, column.of(rows))


def _attach(node: h5py.Group, group: Group) -> None:
    """Make the dimension scales of a group, and attach them."""
    named = {scale for item in group.fields for scale in item.scales}
    for name in sorted(named):
        node[name].make_scale(name)
    for item in group.fields:
        for dimension, name in enumerate(item.scales):
            node[item.name].dims[dimension].attach_scale(node[name])


def _storage(shape: tuple[int, ...], item_bytes: int) -> dict[str, Any]:
    """Filter options: shuffle and gzip, which every HDF5 reader has, for data that compress well."""
    if not shape or math.prod(shape) * item_bytes < _SMALLEST_COMPRESSED:
        return {}
    chunks = (min(shape[0], CHUNK_ROWS), *shape[1:])
    return {"chunks": chunks, "compression": "gzip", "compression_opts": 1, "shuffle": True}


def _sync(path: Path) -> None:
    """Write a file or folder to the disk, and let the next reader take it from there."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)
