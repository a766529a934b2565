"""Opens and validates archives; all datasets are read through this module.

Names, types, shapes, lengths and values are validated against `runs.archive.schema`, and all other code relies on
that: the structure when the file is opened, values when they are read.
"""

from __future__ import annotations

import math
import mmap
import os
import re
import stat
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from runs.archive import checksum
from runs.archive.schema import BYTES, TEXT, ExpectedDataset
from runs.archive.structure import Fields, SchemaViolationError, StructureCheck, member, shown, text_of

_TEXTS_AT_ONCE = 64
_FAULTS = (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)
"""Exceptions by which h5py reports a damaged file."""

Stamp = tuple[int, int, int, int]
"""Device, inode, size and time of change of a file."""
_REMEMBERED = 64
_CHECKED: dict[tuple[Path, Stamp], Fields] = {}


class ArchiveError(Exception):
    """The archive could not be written or is invalid; the message has the reason. The journal is unchanged."""


class ArchiveContents:
    """The datasets of an open archive. Every method raises `ArchiveError` if one is not readable or invalid."""

    def __init__(self, path: Path, file: h5py.File, fields: Fields) -> None:
        self._path = path
        self._file = file
        self._fields = fields

    def fields(self, group: str) -> Mapping[str, ExpectedDataset]:
        """Return the datasets of a group by name; empty if the group is missing."""
        return self._fields.get(group, {})

    def groups(self) -> tuple[str, ...]:
        """Return the paths of the existing groups, outer ones first."""
        return tuple(self._fields)

    def value(self, path: str) -> Any:
        """Return a dataset: an array, a number, a text or a list of texts."""
        group, _, name = path.rpartition("/")
        expected = self._fields[group][name]
        with self._reading(path):
            node = member(self._file, path)
            _fits_memory(node)
            if expected.kind != TEXT:
                found = node[()]
                _check_numbers(found, expected)
                return found
            words = list(_texts(node, self._file.id.get_filesize()))
            _check_texts(words, expected)
            return words if node.shape else words[0]

    def values(self, group: str, without: str = "") -> dict[str, Any]:
        """Return the datasets of a group by name; empty if the group is missing."""
        return {name: self.value(f"{group}/{name}") for name in self.fields(group) if name != without}

    def row(self, path: str, k: int) -> Any:
        """Return one row of a dataset."""
        with self._reading(path):
            return member(self._file, path)[k]

    def about(self, path: str) -> tuple[str, str, float]:
        """Return unit, source and standard uncertainty [the unit] of a number; empty and NaN if missing."""
        with self._reading(path):
            attributes = member(self._file, path).attrs
            unit, source = (text_of(attributes.get(name, ""), f"@{name}") for name in ("units", "source"))
            return unit, source, _number_of(attributes.get("uncertainty", math.nan), "@uncertainty")

    def described(self, path: str) -> tuple[tuple[int, ...], str, str]:
        """Return shape, unit and description of a dataset; texts are empty if missing."""
        with self._reading(path):
            node = member(self._file, path)
            unit, description = (text_of(node.attrs.get(name, ""), f"@{name}") for name in ("units", "description"))
            return node.shape, unit, description

    def comment(self, group: str) -> str:
        """Return the comment on a group; empty if missing."""
        with self._reading(group):
            return text_of(self._file[group].attrs.get("comment", ""), "@comment")

    @contextmanager
    def _reading(self, path: str) -> Iterator[None]:
        try:
            yield
        except SchemaViolationError as fault:
            raise ArchiveError(f"{self._path}: {path}{fault}") from None
        except _FAULTS as fault:
            raise ArchiveError(f"{self._path}: {path}: cannot be read ({_in_words(fault)})") from fault


@contextmanager
def opened(path: Path | str) -> Iterator[ArchiveContents]:
    """Open an archive and check its structure; `ArchiveError` if it is not an archive or damaged."""
    with _opened(Path(path)) as (file, stamp):
        yield ArchiveContents(Path(path), file, _known(Path(path), stamp, file))


@contextmanager
def opened_in_part(path: Path | str, wanted: Iterable[str]) -> Iterator[ArchiveContents]:
    """Open an archive and check only these datasets; others are not readable."""
    with _opened(Path(path)) as (file, _):
        yield ArchiveContents(Path(path), file, _checked(Path(path), file, frozenset(wanted)))


def content_sha256(path: Path | str) -> str:
    """Return the SHA-256 stored in an archive. Checks the archive as `opened` does."""
    with _opened(Path(path)) as (file, stamp):
        _known(Path(path), stamp, file)
        return str(file.attrs["content_sha256"])


def digest_of(path: Path | str) -> str:
    """Return the SHA-256 of the content of an archive; empty if it has unknown datasets."""
    with _opened(Path(path)) as (file, stamp):
        known = {one.path for group in _known(Path(path), stamp, file).values() for one in group.values()}
        try:
            held = set(checksum.paths(file))
            return checksum.of_file(file).sha256 if held == known else ""
        except _FAULTS as fault:
            raise ArchiveError(f"{path}: cannot be read ({_in_words(fault)})") from fault


def _known(path: Path, stamp: Stamp, file: h5py.File) -> Fields:
    """Return the datasets of an archive; the result is cached while the file is unchanged."""
    if (known := _CHECKED.get((path, stamp))) is None:
        known = _checked(path, file, None)
        if len(_CHECKED) >= _REMEMBERED:
            _CHECKED.clear()
        _CHECKED[path, stamp] = known
    return known


@contextmanager
def _opened(path: Path) -> Iterator[tuple[h5py.File, Stamp]]:
    try:
        there = path.stat()
        if not stat.S_ISREG(there.st_mode):
            raise ArchiveError(f"{path}: not an archive of softrig: it is no file")
        file = h5py.File(path, "r")
    except _FAULTS as fault:
        raise ArchiveError(f"{path}: {_why(path, fault)}") from fault
    try:
        yield file, (there.st_dev, there.st_ino, there.st_size, there.st_mtime_ns)
    finally:
        try:
            file.close()
        except _FAULTS as fault:
            raise ArchiveError(f"{path}: cannot be read ({_in_words(fault)})") from fault


def _why(path: Path, fault: Exception) -> str:
    """Return why a file is not readable as an archive."""
    if isinstance(fault, FileNotFoundError):
        return "no such file"
    if path.is_file() and path.stat().st_size == 0:
        return "not an archive of softrig: it is empty"
    if cut := re.search(r"eof = (\d+),.*stored_eof = (\d+)", str(fault)):
        found, stated = (int(number) / 1e6 for number in cut.groups())
        return f"cut off: {found:.3f} of {stated:.3f} MB; copy it again, or rebuild it from its journal (rig recover)"
    if isinstance(fault, PermissionError) or _is_hdf5(path):
        return f"not an archive of softrig ({_in_words(fault)})"
    return "not an archive of softrig: it is no HDF5 file"


def _is_hdf5(path: Path) -> bool:
    try:
        return bool(h5py.is_hdf5(path))
    except _FAULTS:
        return False


def _in_words(fault: Exception) -> str:
    return f"{os.strerror(fault.errno)}" if isinstance(fault, OSError) and fault.errno else str(fault) or repr(fault)


def _checked(path: Path, file: h5py.File, wanted: frozenset[str] | None) -> Fields:
    """Check the structure of an archive, or of the wanted part of it, and return the datasets that it has."""
    check = StructureCheck(file)
    try:
        # Before any text is read: the library would not return from such a heap.
        _check_global_heaps(path)
        return check.everything(wanted)
    except EndlessHeapError as fault:
        raise ArchiveError(f"{path}: cannot be read ({fault})") from None
    except SchemaViolationError as fault:
        raise ArchiveError(f"{path}: {check.where}{fault}") from None
    except _FAULTS as fault:
        raise ArchiveError(f"{path}: {check.where}: cannot be read ({_in_words(fault)})") from fault


def _check_numbers(found: Any, expected: ExpectedDataset) -> None:
    """Check values against their limits; NaN means not measured."""
    if expected.kind == BYTES or np.size(found) == 0:
        return
    if expected.limits is not None:
        low, high = expected.limits
        # NaN is neither below nor above.
        wrong = (found < low) | (found > high)
        _refuse_first(found, wrong, f"{low:g} to {high:g}")
    if expected.finite:
        _refuse_first(found, ~np.isfinite(found), "a number")
    if expected.among:
        _refuse_first(found, ~np.isin(found, [int(value) for value in expected.among]), _one_of(expected.among))


def _refuse_first(found: Any, wrong: Any, expected: str) -> None:
    if np.any(wrong):
        row = "" if np.ndim(found) == 0 else f"[{', '.join(str(i) for i in np.argwhere(wrong)[0])}]"
        raise SchemaViolationError(str(np.asarray(found)[wrong].flat[0]), expected, row)


def _check_texts(words: list[str], expected: ExpectedDataset) -> None:
    if expected.among:
        for row, word in enumerate(words):
            if word not in expected.among:
                raise SchemaViolationError(
                    shown(word), _one_of(expected.among), f"[{row}]" if expected.dimensions else ""
                )


def _one_of(values: Iterable[str | int]) -> str:
    shown = [str(value) if isinstance(value, str) else str(int(value)) for value in values]
    return f"one of {', '.join(shown[:8])}{', ..' if len(shown) > 8 else ''}"


def _texts(node: h5py.Dataset, file_bytes: int) -> Iterator[str]:
    """Yield texts; their total length is limited to the file size."""
    total = 0
    for low in range(0, node.shape[0] if node.shape else 1, _TEXTS_AT_ONCE):
        words = node[low : low + _TEXTS_AT_ONCE] if node.shape else [node[()]]
        for row, word in enumerate(words, low):
            total += len(word)
            if total > file_bytes:
                raise SchemaViolationError(f"text of more than {total} bytes", f"at most the {file_bytes} of the file")
            try:
                yield word.decode("utf-8")
            except UnicodeDecodeError as fault:
                place = f"[{row}]" if node.shape else ""
                raise SchemaViolationError(shown(word), f"UTF-8 (not so at byte {fault.start})", place) from None


def _number_of(value: Any, where: str) -> float:
    if not isinstance(value, float | int | np.floating | np.integer):
        raise SchemaViolationError(shown(value), "a number", where)
    return float(value)


def _fits_memory(node: h5py.Dataset) -> None:
    half = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    # Not `nbytes`: h5py makes a NumPy type for it, which takes longer than to open the dataset.
    size = math.prod(node.shape) * node.id.get_type().get_size()
    if size > half:
        raise SchemaViolationError(f"{size} bytes", f"at most {half}, half of this machine's memory")


_COLLECTION = re.compile(rb"GCOL\x01\0\0\0")
_HEAD = struct.Struct("<8xQ")
"""Of a collection: signature and version, then its size with this head."""
_OBJECT = struct.Struct("<HHxxxxQ")
"""Before each object: index, number of references, size. Index 0 is the free rest, whose size includes this head."""
_ALIGNED = 8


class EndlessHeapError(Exception):
    """A global heap that no reader comes to the end of; the message has its place."""


def _check_global_heaps(path: Path) -> None:
    """Follow each global heap, which holds texts, from object to object: HDF5 never leaves one with an empty object.

    Format: HDF5 File Format Specification 3.0, section III.E.

    Raises:
        EndlessHeapError: the free rest of one has a size of zero.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for found in _COLLECTION.finditer(content):
            start = found.start()
            if start + _HEAD.size > len(content):
                continue
            (size,) = _HEAD.unpack_from(content, start)
            place, end = start + _HEAD.size, min(start + size, len(content))
            while place + _OBJECT.size <= end:
                index, _, length = _OBJECT.unpack_from(content, place)
                if index == 0 and length == 0:
                    raise EndlessHeapError(f"the global heap at byte {start} has an empty object at byte {place}")
                place += length if index == 0 else _OBJECT.size + -(-length // _ALIGNED) * _ALIGNED
