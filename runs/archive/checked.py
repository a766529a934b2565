"""Opens archives: the digest of the file first, then its groups and datasets against `runs.archive.schema`.

All datasets are read through this module. All other code relies on names, types, shapes and units.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from runs.archive import digest, layout
from runs.archive.digest import ArchiveError as ArchiveError
from runs.archive.schema import TEXT, ExpectedDataset, GroupSchema, kind_of, name_of, schema
from runs.columns.declaration import OLDEST_LAYOUT

_FAULTS = (ArithmeticError, AttributeError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError)
"""Exceptions by which h5py reports a damaged file that is read in spite of its digest."""

Fields = Mapping[str, Mapping[str, ExpectedDataset]]
"""The datasets that an archive has, by group and name."""
_REMEMBERED = 64
_fields_by_digest: dict[str, Fields] = {}


class SchemaViolationError(Exception):
    """An invalid part of an archive: its path, found and expected."""

    def __init__(self, path: str, found: str, expected: str) -> None:
        super().__init__(f"{path}: found {found}, expected {expected}")


class ArchiveContents:
    """The datasets of an open archive. Every method raises `ArchiveError` if one is not readable or invalid."""

    def __init__(self, path: Path, file: h5py.File, fields: Fields, sha256: str) -> None:
        self.sha256 = sha256
        """Digest of the file."""
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
        with _reading(self._path, path):
            node = self._file[path]
            found = node.asstr()[()] if expected.kind == TEXT else node[()]
            _check_values(found, expected)
            return list(found) if expected.kind == TEXT and node.shape else found

    def values(self, group: str, without: str = "") -> dict[str, Any]:
        """Return the datasets of a group by name; empty if the group is missing."""
        return {name: self.value(f"{group}/{name}") for name in self.fields(group) if name != without}

    def row(self, path: str, k: int) -> Any:
        """Return one row of a dataset."""
        with _reading(self._path, path):
            return self._file[path][k]

    def about(self, path: str) -> tuple[str, str, float]:
        """Return unit, source and standard uncertainty [the unit] of a number; empty and NaN if missing."""
        with _reading(self._path, path):
            attributes = self._file[path].attrs
            unit, source = (str(attributes.get(name, "")) for name in ("units", "source"))
            return unit, source, float(attributes.get("uncertainty", math.nan))

    def described(self, path: str) -> tuple[tuple[int, ...], str, str]:
        """Return shape, unit and description of a dataset; texts are empty if missing."""
        with _reading(self._path, path):
            node = self._file[path]
            unit, description = (str(node.attrs.get(name, "")) for name in ("units", "description"))
            return node.shape, unit, description

    def comment(self, group: str) -> str:
        """Return the comment on a group; empty if missing."""
        with _reading(self._path, group):
            return str(self._file[group].attrs.get("comment", ""))


@contextmanager
def opened(path: Path | str) -> Iterator[ArchiveContents]:
    """Open an archive.

    Raises:
        DamagedArchiveError: the file is not as softrig wrote it.
        ArchiveError: it is no archive, or one of another layout.
    """
    path = Path(path)
    try:
        sha256 = digest.checked(path)
    except FileNotFoundError:
        raise ArchiveError(f"{path}: no such file") from None
    except OSError as fault:
        raise ArchiveError(f"{path}: cannot be read ({_in_words(fault)})") from None
    with _reading(path, "not an archive of softrig"):
        file = h5py.File(path, "r")
    with file:
        if (fields := _fields_by_digest.get(sha256)) is None:
            with _reading(path, "its structure"):
                fields = _structure(file)
            if len(_fields_by_digest) >= _REMEMBERED:
                _fields_by_digest.clear()
            _fields_by_digest[sha256] = fields
        yield ArchiveContents(path, file, fields, sha256)


@contextmanager
def _reading(path: Path, place: str) -> Iterator[None]:
    """Report what cannot be read with file and place."""
    try:
        yield
    except SchemaViolationError as fault:
        raise ArchiveError(f"{path}: {fault}") from None
    except _FAULTS as fault:
        raise ArchiveError(f"{path}: {place}: cannot be read ({_in_words(fault)})") from fault


def _in_words(fault: Exception) -> str:
    return f"{os.strerror(fault.errno)}" if isinstance(fault, OSError) and fault.errno else str(fault) or repr(fault)


def _structure(file: h5py.File) -> Fields:
    """Check the datasets of a file and return those that it has."""
    version = _layout_of(file)
    found: dict[str, dict[str, ExpectedDataset]] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    for group in schema(*(_channels(file, f"entry/{name}") for name in ("actuators", "valves"))):
        node = file.get(group.path)
        if isinstance(node, h5py.Group):
            found[group.path] = {}
            for one in _present(group, node, version):
                dataset = node[one.name]
                found[group.path][one.name] = _like(group, one, dataset)
                shapes[one.path] = dataset.shape
        elif group.required:
            raise SchemaViolationError(group.path, "nothing", "a group")
    for fields in found.values():
        for one in fields.values():
            _check_shape(shapes, one)
    return found


def _layout_of(file: h5py.File) -> int:
    """Return the version of the layout, if it is one that is read."""
    if "layout_version" not in file.attrs:
        raise SchemaViolationError(
            "its attributes, @layout_version", "nothing", "what softrig writes there; this is not an archive of softrig"
        )
    version = int(file.attrs["layout_version"])
    if not OLDEST_LAYOUT <= version <= layout.VERSION:
        made = "a newer" if version > layout.VERSION else "an older"
        known = f"{OLDEST_LAYOUT}" if OLDEST_LAYOUT == layout.VERSION else f"{OLDEST_LAYOUT} to {layout.VERSION}"
        raise SchemaViolationError(
            "its attributes, @layout_version", f"layout {version}", f"{known}: {made} softrig made it"
        )
    return version


def _channels(file: h5py.File, path: str) -> int:
    """Return the number of actuators or valves."""
    number = int(file[path][()])
    if not 0 <= number <= layout.MOST_CHANNELS:
        raise SchemaViolationError(path, str(number), f"0 to {layout.MOST_CHANNELS}")
    return number


def _present(group: GroupSchema, node: h5py.Group, version: int) -> Iterator[ExpectedDataset]:
    """Yield the datasets of a group by the schema, and of an open group those of the run."""
    for one in group.datasets.values():
        if isinstance(node.get(one.name), h5py.Dataset):
            yield one
        elif one.required and one.since <= version:
            raise SchemaViolationError(one.path, "nothing", name_of(one.kind))
    if group.alike:
        for name in node:
            # A subgroup is either another group of the layout or is never read.
            if name not in group.datasets and isinstance(node.get(name), h5py.Dataset):
                yield replace(group.alike[0], path=f"{group.path}/{name}", required=True)


def _like(group: GroupSchema, one: ExpectedDataset, dataset: h5py.Dataset) -> ExpectedDataset:
    """Return what a dataset is expected to be: in an open group the first example of its type and dimensions."""
    kind, shape = kind_of(dataset.dtype), dataset.shape
    if one.name not in group.datasets:
        for example in group.alike:
            if kind == example.kind and shape is not None and len(shape) == len(example.dimensions):
                return replace(example, path=one.path, dimensions=(one.path,) * len(example.dimensions), required=False)
        kinds = " or ".join(sorted({f"{name_of(e.kind)} of {len(e.dimensions)} dimensions" for e in group.alike}))
        raise SchemaViolationError(one.path, _described(dataset), kinds)
    if kind != one.kind or shape is None:
        raise SchemaViolationError(one.path, _described(dataset), name_of(one.kind))
    if one.units and (unit := dataset.attrs.get("units")) != one.units:
        raise SchemaViolationError(f"{one.path}@units", repr(unit), repr(one.units))
    return one


def _described(dataset: h5py.Dataset) -> str:
    kind = kind_of(dataset.dtype)
    return f"{name_of(kind) if kind else f'values of type {dataset.dtype}'} of shape {dataset.shape}"


def _check_shape(shapes: Mapping[str, tuple[int, ...]], one: ExpectedDataset) -> None:
    shape = shapes[one.path]
    if len(shape) != len(one.dimensions):
        raise SchemaViolationError(one.path, f"shape {shape}", f"{len(one.dimensions)} dimensions")
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
        raise SchemaViolationError(one.path, f"shape {shape}", f"{tuple(expected)}{as_long}")


def _check_values(found: Any, expected: ExpectedDataset) -> None:
    """Check that a value of a list of words or numbers, as a status, is in it."""
    if not expected.among:
        return
    kind = object if expected.kind == TEXT else int
    values = np.asarray(found, dtype=kind)
    wrong = ~np.isin(values, np.array(expected.among, dtype=kind))
    if wrong.any():
        row = f"[{', '.join(str(i) for i in np.argwhere(wrong)[0])}]" if values.ndim else ""
        word = values[wrong].flat[0]
        raise SchemaViolationError(
            f"{expected.path}{row}", repr(word) if kind is object else str(word), _one_of(expected.among)
        )


def _one_of(values: Iterable[str | int]) -> str:
    shown = [str(value) if isinstance(value, str) else str(int(value)) for value in values]
    return f"one of {', '.join(shown[:8])}{', ..' if len(shown) > 8 else ''}"
