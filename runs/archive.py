"""The archive of a run: a journal turned into NeXus HDF5, whole or not at all.

Written under a temporary name, read back and compared with what was meant, then renamed.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from runs import digest, journal, layout
from runs.groups import Field, Group, Pictures
from runs.journal import ARCHIVE_TO_JOURNAL, NO_ROOM

SUFFIX = ".h5"
PART = ".h5.part"
"""End of the name while the archive is being written."""
_MARGIN_BYTES = 4 << 20
_CHUNK_ROWS = 16384
_SMALLEST_COMPRESSED = 512


class ArchiveError(Exception):
    """The archive could not be written or is not one; the message says why. The journal is as it was."""


class StillWrittenError(ArchiveError):
    """The journal is held by a process that writes it."""


def finalise(journal_path: Path | str, archive_path: Path | str | None = None) -> Path:
    """Turn a journal into an archive and return the archive's path; the journal stays.

    By default the archive stands beside the journal. A journal without a footer gives an archive with status
    `recovered`. An archive that is already there is replaced. `ArchiveError` or `runs.journal.JournalError`.
    """
    source = Path(journal_path)
    target = source.with_suffix(SUFFIX) if archive_path is None else Path(archive_path)
    with held(source):
        content = journal.read(source)
        write(content, target, _MARGIN_BYTES + int(ARCHIVE_TO_JOURNAL * source.stat().st_size))
    return target


def write(content: journal.Journal, target: Path, most_bytes: int) -> None:
    """Write an archive of at most this size under a temporary name, check it, and give it its name."""
    part = target.with_name(target.name.removesuffix(SUFFIX) + PART)
    try:
        _find_room(part, most_bytes)
        meant = _write(part, target.name, layout.groups(content))
        with h5py.File(part, "r") as file:
            if digest.of_file(file) != meant:
                raise ArchiveError(f"{part}: what was read back is not what was written; is the disk sound?")
        _sync(part)
        part.replace(target)
        _sync(target.parent)
    except (OSError, RuntimeError, ValueError) as fault:
        # HDF5 tells of its troubles as any of these, some only when the file is closed.
        with suppress(OSError):
            part.unlink(missing_ok=True)
        number = fault.errno if isinstance(fault, OSError) else None
        full = number in NO_ROOM or any(os.strerror(code) in str(fault) for code in NO_ROOM)
        reason = "the disk is full" if full else str(fault)
        raise ArchiveError(f"cannot write {target}: {reason}; the journal holds everything") from fault


@contextmanager
def held(source: Path) -> Iterator[None]:
    """Hold a journal, so that it is finalised once at a time; `StillWrittenError` while its writer lives."""
    try:
        handle = os.open(source, os.O_RDONLY | os.O_CLOEXEC)
    except OSError as fault:
        raise journal.JournalError(f"cannot read {source}: {fault.strerror}") from fault
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as fault:
            raise StillWrittenError(f"{source} is being written by another process") from fault
        yield
    finally:
        os.close(handle)


def verify(path: Path | str) -> bool:
    """Tell whether the content of an archive is what its own SHA-256 says."""
    try:
        with h5py.File(path, "r") as file:
            return bool(digest.of_file(file) == file.attrs["content_sha256"])
    except (OSError, KeyError, ValueError, RuntimeError) as fault:
        raise ArchiveError(f"{path} is not an archive that can be read: {fault}") from fault


def _find_room(part: Path, size: int) -> None:
    """Raise `OSError` where a file has no room: a process whose HDF5 meets a full disk may crash when it ends."""
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
    try:
        os.posix_fallocate(handle, 0, size)
    finally:
        os.close(handle)


def _write(part: Path, name: str, groups: tuple[Group, ...]) -> str:
    """Write every group and return the digest of what was meant."""
    contents: dict[str, digest.Content] = {}
    with h5py.File(part, "w") as file:
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
            for item in group.fields:
                path = f"{group.path}/{item.name}"
                contents[path] = _put_pictures(node, item) if isinstance(item, Pictures) else _put(node, item)
            _attach(node, group)
        sha256 = digest.of(contents)
        file.attrs.update(
            NX_class="NXroot",
            default="entry",
            creator="softrig",
            layout_version=layout.VERSION,
            file_name=name,
            file_time=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            HDF5_Version=h5py.version.hdf5_version,
            h5py_version=h5py.version.version,
            content_sha256=sha256,
        )
    return sha256


def _put(node: h5py.Group, item: Field) -> digest.Content:
    """Write one field and return what was meant by it."""
    attributes: dict[str, Any] = {"units": item.units, "description": item.about, "source": item.source}
    if item.uncertainty is not None:
        attributes["uncertainty"] = item.uncertainty
    meant: digest.Content
    if isinstance(item.value, str | list):
        words = [item.value] if isinstance(item.value, str) else item.value
        # HDF5 ends a text at its first NUL.
        words = [word.replace("\0", "\N{SYMBOL FOR NULL}") for word in words]
        shape = () if isinstance(item.value, str) else (len(words),)
        data = words[0] if isinstance(item.value, str) else np.array(words, dtype=object)
        dataset = node.create_dataset(item.name, shape, h5py.string_dtype(), data)
        meant = digest.texts(words, shape)
    else:
        values = np.asarray(item.value)
        dataset = node.create_dataset(item.name, data=values, **_storage(values))
        meant = digest.numbers(values)
    for name, value in attributes.items():
        if value != "":
            dataset.attrs[name] = value
    return meant


def _put_pictures(node: h5py.Group, item: Pictures) -> digest.Content:
    dataset = node.create_dataset(item.name, (len(item.data),), h5py.vlen_dtype(np.uint8))
    for index, data in enumerate(item.data):
        dataset[index] = np.frombuffer(data, np.uint8)
    dataset.attrs["description"] = item.about
    return "bytes", (len(item.data),), item.data


def _attach(node: h5py.Group, group: Group) -> None:
    """Make the dimension scales of a group, and attach them."""
    named = {scale for item in group.fields for scale in item.scales}
    for name in sorted(named):
        node[name].make_scale(name)
    for item in group.fields:
        for dimension, name in enumerate(item.scales):
            node[item.name].dims[dimension].attach_scale(node[name])


def _storage(values: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Compress what is worth it, with the one filter that every HDF5 reader has."""
    if values.ndim == 0 or values.nbytes < _SMALLEST_COMPRESSED:
        return {}
    chunks = (min(len(values), _CHUNK_ROWS), *values.shape[1:])
    return {"chunks": chunks, "compression": "gzip", "compression_opts": 1, "shuffle": True}


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
