"""Opens and validates archives; all datasets are read through this module.

Names, types, shapes, lengths and values are validated against `runs.archive.schema`, and all other code relies on
that: the structure when the file is opened, values when they are read.
"""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from runs.archive import checksum, layout
from runs.archive.schema import BYTES, TEXT, Expected, GroupSchema, kind_of, name_of, schema

FREE_BYTES = 64 << 20
"""Allowed uncompressed size of any archive; larger ones may have at most `INFLATED` times their file size."""
INFLATED = 500
"""Constant columns compress to a thousandth; time columns, which every table has, to a thirtieth."""
_TEXTS_AT_ONCE = 64
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
_FAULTS = (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)
"""Exceptions by which h5py reports a damaged file."""

Fields = Mapping[str, Mapping[str, Expected]]
"""The datasets that an archive has, by group and name."""
Stamp = tuple[int, int, int, int]
"""Device, inode, size and time of change of a file."""
_REMEMBERED = 64
_CHECKED: dict[tuple[Path, Stamp], Fields] = {}


class ArchiveError(Exception):
    """The archive could not be written or is invalid; the message has the reason. The journal is unchanged."""


class Contents:
    """The datasets of an open archive. Every method raises `ArchiveError` if one is not readable or invalid."""

    def __init__(self, path: Path, file: h5py.File, fields: Fields) -> None:
        self._path = path
        self._file = file
        self._fields = fields

    def fields(self, group: str) -> Mapping[str, Expected]:
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
            node = self._file[path]
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
            return self._file[path][k]

    def about(self, path: str) -> tuple[str, str, float]:
        """Return unit, source and standard uncertainty [the unit] of a number; empty and NaN if missing."""
        with self._reading(path):
            attributes = self._file[path].attrs
            unit, source = (_text_of(attributes.get(name, ""), f"@{name}") for name in ("units", "source"))
            return unit, source, _number_of(attributes.get("uncertainty", math.nan), "@uncertainty")

    @contextmanager
    def _reading(self, path: str) -> Iterator[None]:
        try:
            yield
        except WrongError as fault:
            raise ArchiveError(f"{self._path}: {path}{fault}") from None
        except _FAULTS as fault:
            raise ArchiveError(f"{self._path}: {path}: cannot be read ({_in_words(fault)})") from fault


class WrongError(Exception):
    """An invalid part of an archive: found and expected values."""

    def __init__(self, found: str, expected: str, where: str = "") -> None:
        super().__init__(f"{where}: found {found}, expected {expected}")


@contextmanager
def opened(path: Path | str) -> Iterator[Contents]:
    """Open an archive and check its structure; `ArchiveError` if it is not an archive or damaged."""
    with _opened(Path(path)) as (file, stamp):
        yield Contents(Path(path), file, _known(Path(path), stamp, file))


@contextmanager
def opened_in_part(path: Path | str, wanted: Iterable[str]) -> Iterator[Contents]:
    """Open an archive and check only these datasets; others are not readable."""
    with _opened(Path(path)) as (file, _):
        yield Contents(Path(path), file, _checked(Path(path), file, frozenset(wanted)))


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
    if (path, stamp) not in _CHECKED:
        if len(_CHECKED) >= _REMEMBERED:
            _CHECKED.clear()
        _CHECKED[path, stamp] = _checked(path, file, None)
    return _CHECKED[path, stamp]


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
    check = _Check(file)
    try:
        return check.everything(wanted)
    except WrongError as fault:
        raise ArchiveError(f"{path}: {check.where}{fault}") from None
    except _FAULTS as fault:
        raise ArchiveError(f"{path}: {check.where}: cannot be read ({_in_words(fault)})") from fault


class _Check:
    """Checks the groups and datasets of a file; `where` is the path of the current one."""

    def __init__(self, file: h5py.File) -> None:
        self.where = "its attributes"
        self._file = file
        self._file_bytes = int(file.id.get_filesize())
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._declared_bytes = 0

    def everything(self, wanted: frozenset[str] | None) -> Fields:
        """Check all datasets, or only the wanted ones."""
        _check_attributes(self._file)
        actuators, valves = self._channels("entry/actuators"), self._channels("entry/valves")
        found = {}
        for group in schema(actuators, valves):
            self.where = group.path
            node = _member(self._file, group.path, h5py.Group)
            if node is not None:
                found[group.path] = dict(self._datasets(group, node, wanted))
            elif group.required:
                raise WrongError("nothing", "a group")
        self.where = "all datasets together"
        most = FREE_BYTES + INFLATED * self._file_bytes
        if self._declared_bytes > most:
            raise WrongError(f"{self._declared_bytes} bytes once read", f"at most {most} in a file of this size")
        for fields in found.values():
            for one in fields.values():
                self.where = one.path
                _check_shape(self._shapes, one)
        return found

    def _datasets(
        self, group: GroupSchema, node: h5py.Group, wanted: frozenset[str] | None
    ) -> Iterator[tuple[str, Expected]]:
        for one in _present(group, node, wanted):
            self.where = one.path
            dataset = _member(node, one.name, h5py.Dataset)
            if dataset is not None:
                known = _like(group, one, dataset)
                self._declared_bytes += _check_storage(dataset, self._file_bytes)
                self._shapes[one.path] = dataset.shape
                yield one.name, known
            elif one.required:
                raise WrongError("nothing", name_of(one.kind))

    def _channels(self, path: str) -> int:
        """Return the number of actuators or valves."""
        self.where = path
        dataset = _member(self._file, path, h5py.Dataset)
        if dataset is None:
            raise WrongError("nothing", f"one number ({name_of('i4')})")
        if dataset.shape != () or kind_of(dataset.dtype) != "i4":
            raise WrongError(_described(dataset), f"one number ({name_of('i4')})")
        _check_storage(dataset, self._file_bytes)
        number = int(dataset[()])
        if not 0 <= number <= layout.MOST_CHANNELS:
            raise WrongError(str(number), f"0 to {layout.MOST_CHANNELS}")
        return number


def _check_attributes(file: h5py.File) -> None:
    for name in ("layout_version", "content_sha256"):
        if name not in file.attrs:
            raise WrongError("nothing", "what softrig writes there; this is not an archive of softrig", f", @{name}")
    version = file.attrs["layout_version"]
    if not isinstance(version, np.integer | int):
        raise WrongError(_shown(version), "an integer", ", @layout_version")
    if version != layout.VERSION:
        made = "a newer" if version > layout.VERSION else "an older"
        raise WrongError(f"layout {version}", f"{layout.VERSION}: {made} softrig made it", ", @layout_version")
    _text_of(file.attrs["content_sha256"], ", @content_sha256")


def _present(group: GroupSchema, node: h5py.Group, wanted: frozenset[str] | None) -> Iterator[Expected]:
    """Yield the datasets of a group by the schema, and of an open group those of the run."""
    yield from (one for one in group.datasets.values() if wanted is None or one.path in wanted)
    if group.alike and wanted is None:
        for name in node:
            if not isinstance(name, str):
                raise WrongError(f"the name {name!r}", "a name in UTF-8")
            path = f"{group.path}/{name}"
            # A subgroup is either another group of the layout or is never read.
            if name not in group.datasets and not _is_group(node, name):
                yield replace(group.alike[0], path=path, required=True)


def _is_group(parent: h5py.Group, name: str) -> bool:
    return _is_hard(parent, name) and isinstance(parent[name], h5py.Group)


def _is_hard(parent: h5py.Group, name: str) -> bool:
    return bool(parent.id.links.get_info(name.encode()).type == h5py.h5l.TYPE_HARD)


def _member(parent: h5py.Group, path: str, kind: type) -> Any:
    """Return a group or dataset by its path; None where there is none. External and soft links are refused."""
    node: Any = parent
    for name in path.split("/"):
        if not isinstance(node, h5py.Group) or not node.id.links.exists(name.encode()):
            return None
        if not _is_hard(node, name):
            raise WrongError("a link to elsewhere", f"a {kind.__name__.lower()}")
        node = node[name]
    if not isinstance(node, kind):
        raise WrongError(f"a {type(node).__name__.lower()}", f"a {kind.__name__.lower()}")
    return node


def _like(group: GroupSchema, one: Expected, dataset: h5py.Dataset) -> Expected:
    """Return what a dataset is expected to be: in an open group the first matching example."""
    kind = kind_of(dataset.dtype)
    if one.name in group.datasets:
        if kind != one.kind:
            raise WrongError(_described(dataset), name_of(one.kind))
        return one
    for example in group.alike:
        if kind == example.kind and dataset.shape is not None and len(dataset.shape) == len(example.dimensions):
            return replace(example, path=one.path, dimensions=(one.path,) * len(example.dimensions), required=False)
    kinds = " or ".join(sorted({f"{name_of(e.kind)} of {len(e.dimensions)} dimensions" for e in group.alike}))
    raise WrongError(_described(dataset), kinds)


def _check_storage(dataset: h5py.Dataset, file_bytes: int) -> int:
    """Check that a dataset is stored in the file itself; return its size in memory [bytes]."""
    if dataset.shape is None:
        raise WrongError("no data at all", "a value")
    creation = dataset.id.get_create_plist()
    kind = creation.get_layout()
    if kind == h5py.h5d.VIRTUAL or creation.get_external_count():
        raise WrongError("data that is stored elsewhere", "data in the file itself")
    filters = {creation.get_filter(i)[0] for i in range(creation.get_nfilters())}
    if not filters <= _FILTERS:
        raise WrongError(f"the HDF5 filters {sorted(filters)}", "shuffle and gzip only")
    count, stored = math.prod(dataset.shape), dataset.id.get_storage_size()
    size = int(count * dataset.dtype.itemsize)
    if stored > file_bytes:
        raise WrongError(f"{stored} stored bytes", f"at most the {file_bytes} of the file")
    if kind == h5py.h5d.CHUNKED:
        chunks = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
        kept = dataset.id.get_num_chunks()
        if chunks != kept:
            raise WrongError(
                f"{kept} stored chunks of shape {dataset.chunks}", f"the {chunks} of shape {dataset.shape}"
            )
        size = int(chunks * math.prod(dataset.chunks) * dataset.dtype.itemsize)
    elif stored < size:
        raise WrongError(f"{stored} stored bytes", f"{size}, as its shape {dataset.shape} says")
    return size


def _check_shape(shapes: Mapping[str, tuple[int, ...]], one: Expected) -> None:
    shape = shapes[one.path]
    if len(shape) != len(one.dimensions):
        raise WrongError(f"shape {shape}", f"{len(one.dimensions)} dimensions")
    expected, owners = [], []
    for dimension, length in zip(one.dimensions, shape, strict=True):
        if isinstance(dimension, int):
            expected.append(dimension)
        elif dimension == one.path or dimension not in shapes:
            expected.append(length)
        else:
            expected.append(shapes[dimension][0])
            owners.append(dimension)
    if tuple(expected) != shape:
        as_long = f" (as {', '.join(owners)})" if owners else ""
        raise WrongError(f"shape {shape}", f"{tuple(expected)}{as_long}")


def _check_numbers(found: Any, expected: Expected) -> None:
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
        raise WrongError(str(np.asarray(found)[wrong].flat[0]), expected, row)


def _check_texts(words: list[str], expected: Expected) -> None:
    if expected.among:
        for row, word in enumerate(words):
            if word not in expected.among:
                raise WrongError(_shown(word), _one_of(expected.among), f"[{row}]" if expected.dimensions else "")


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
                raise WrongError(f"text of more than {total} bytes", f"at most the {file_bytes} of the file")
            try:
                yield word.decode("utf-8")
            except UnicodeDecodeError as fault:
                place = f"[{row}]" if node.shape else ""
                raise WrongError(_shown(word), f"UTF-8 (not so at byte {fault.start})", place) from None


def _text_of(value: Any, where: str) -> str:
    if not isinstance(value, str) or not _is_unicode(value):
        raise WrongError(_shown(value), "text in UTF-8", where)
    return value


def _is_unicode(text: str) -> bool:
    """Return whether a text has no lone surrogates, which represent invalid UTF-8."""
    return not any("\ud800" <= sign <= "\udfff" for sign in text)


def _number_of(value: Any, where: str) -> float:
    if not isinstance(value, float | int | np.floating | np.integer):
        raise WrongError(_shown(value), "a number", where)
    return float(value)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}.."


def _described(dataset: h5py.Dataset) -> str:
    kind = kind_of(dataset.dtype)
    return f"{name_of(kind) if kind else f'values of type {dataset.dtype}'} of shape {dataset.shape}"


def _fits_memory(node: h5py.Dataset) -> None:
    half = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    if node.nbytes > half:
        raise WrongError(f"{node.nbytes} bytes", f"at most {half}, half of this machine's memory")
