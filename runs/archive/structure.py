"""Check the structure of an archive against `runs.archive.schema`: groups, names, types, shapes and storage."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from runs.archive import layout
from runs.archive.schema import ExpectedDataset, GroupSchema, kind_of, name_of, schema
from runs.columns.declaration import OLDEST_LAYOUT

FREE_BYTES = 64 << 20
"""Allowed uncompressed size of any archive; larger ones may have at most `INFLATED` times their file size."""
INFLATED = 500
"""Constant columns compress to a thousandth; time columns, which every table has, to a thirtieth."""
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}

Fields = Mapping[str, Mapping[str, ExpectedDataset]]
"""The datasets that an archive has, by group and name."""


class SchemaViolationError(Exception):
    """An invalid part of an archive: found and expected values."""

    def __init__(self, found: str, expected: str, where: str = "") -> None:
        super().__init__(f"{where}: found {found}, expected {expected}")


class StructureCheck:
    """Checks the groups and datasets of a file; `where` is the path of the current one."""

    def __init__(self, file: h5py.File) -> None:
        self.where = "its attributes"
        self._file = file
        self._file_bytes = int(file.id.get_filesize())
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._declared_bytes = 0
        self._layout = layout.VERSION

    def everything(self, wanted: frozenset[str] | None) -> Fields:
        """Check all datasets, or only the wanted ones."""
        self._layout = _layout_of(self._file)
        actuators, valves = self._channels("entry/actuators"), self._channels("entry/valves")
        found = {}
        for group in schema(actuators, valves):
            self.where = group.path
            node = _member(self._file, group.path, h5py.Group)
            if node is not None:
                found[group.path] = dict(self._datasets(group, node, wanted))
            elif group.required:
                raise SchemaViolationError("nothing", "a group")
        self.where = "all datasets together"
        most = FREE_BYTES + INFLATED * self._file_bytes
        if self._declared_bytes > most:
            raise SchemaViolationError(
                f"{self._declared_bytes} bytes once read", f"at most {most} in a file of this size"
            )
        for fields in found.values():
            for one in fields.values():
                self.where = one.path
                _check_shape(self._shapes, one)
        return found

    def _datasets(
        self, group: GroupSchema, node: h5py.Group, wanted: frozenset[str] | None
    ) -> Iterator[tuple[str, ExpectedDataset]]:
        for one in _present(group, node, wanted):
            self.where = one.path
            dataset = _member(node, one.name, h5py.Dataset)
            if dataset is not None:
                known = _like(group, one, dataset)
                self._declared_bytes += _check_storage(dataset, self._file_bytes)
                self._shapes[one.path] = dataset.shape
                yield one.name, known
            elif one.required and one.since <= self._layout:
                raise SchemaViolationError("nothing", name_of(one.kind))

    def _channels(self, path: str) -> int:
        """Return the number of actuators or valves."""
        self.where = path
        dataset = _member(self._file, path, h5py.Dataset)
        if dataset is None:
            raise SchemaViolationError("nothing", f"one number ({name_of('i4')})")
        if dataset.shape != () or kind_of(dataset.dtype) != "i4":
            raise SchemaViolationError(_described(dataset), f"one number ({name_of('i4')})")
        _check_storage(dataset, self._file_bytes)
        number = int(dataset[()])
        if not 0 <= number <= layout.MOST_CHANNELS:
            raise SchemaViolationError(str(number), f"0 to {layout.MOST_CHANNELS}")
        return number


def _layout_of(file: h5py.File) -> int:
    """Check the attributes of a file; return the version of its layout."""
    for name in ("layout_version", "content_sha256"):
        if name not in file.attrs:
            raise SchemaViolationError(
                "nothing", "what softrig writes there; this is not an archive of softrig", f", @{name}"
            )
    version = file.attrs["layout_version"]
    if not isinstance(version, np.integer | int):
        raise SchemaViolationError(shown(version), "an integer", ", @layout_version")
    if not OLDEST_LAYOUT <= version <= layout.VERSION:
        made = "a newer" if version > layout.VERSION else "an older"
        known = f"{OLDEST_LAYOUT}" if OLDEST_LAYOUT == layout.VERSION else f"{OLDEST_LAYOUT} to {layout.VERSION}"
        raise SchemaViolationError(f"layout {version}", f"{known}: {made} softrig made it", ", @layout_version")
    text_of(file.attrs["content_sha256"], ", @content_sha256")
    return int(version)


def _present(group: GroupSchema, node: h5py.Group, wanted: frozenset[str] | None) -> Iterator[ExpectedDataset]:
    """Yield the datasets of a group by the schema, and of an open group those of the run."""
    yield from (one for one in group.datasets.values() if wanted is None or one.path in wanted)
    if group.alike:
        # Of a part only the wanted names are looked up: an open group may be large.
        inside = {path.removeprefix(f"{group.path}/") for path in wanted or ()}
        for name in node if wanted is None else sorted(name for name in inside if "/" not in name and name in node):
            if not isinstance(name, str):
                raise SchemaViolationError(f"the name {name!r}", "a name in UTF-8")
            path = f"{group.path}/{name}"
            # A subgroup is either another group of the layout or is never read.
            if name not in group.datasets and not _is_group(node, name):
                yield replace(group.alike[0], path=path, required=True)


def _is_group(parent: h5py.Group, name: str) -> bool:
    return _is_hard(parent, name) and isinstance(parent[name], h5py.Group)


def _is_hard(parent: h5py.Group, name: str) -> bool:
    return bool(parent.id.links.get_info(name.encode()).type == h5py.h5l.TYPE_HARD)


def member(parent: h5py.Group, path: str) -> Any:
    """Return an object of a file that is open for reading, as `parent[path]` does in twice the time."""
    found = h5py.h5o.open(parent.id, path.encode())
    if isinstance(found, h5py.h5d.DatasetID):
        return h5py.Dataset(found, readonly=True)
    return h5py.Group(found) if isinstance(found, h5py.h5g.GroupID) else h5py.Datatype(found)


def _member(parent: h5py.Group, path: str, kind: type) -> Any:
    """Return a group or dataset by its path; None where there is none. External and soft links are refused."""
    node: Any = parent
    for name in path.split("/"):
        if not isinstance(node, h5py.Group) or not node.id.links.exists(name.encode()):
            return None
        if not _is_hard(node, name):
            raise SchemaViolationError("a link to elsewhere", f"a {kind.__name__.lower()}")
        node = member(node, name)
    if not isinstance(node, kind):
        raise SchemaViolationError(f"a {type(node).__name__.lower()}", f"a {kind.__name__.lower()}")
    return node


def _like(group: GroupSchema, one: ExpectedDataset, dataset: h5py.Dataset) -> ExpectedDataset:
    """Return what a dataset is expected to be: in an open group the first matching example."""
    kind = kind_of(dataset.dtype)
    if one.name in group.datasets:
        if kind != one.kind:
            raise SchemaViolationError(_described(dataset), name_of(one.kind))
        return one
    for example in group.alike:
        if kind == example.kind and dataset.shape is not None and len(dataset.shape) == len(example.dimensions):
            return replace(example, path=one.path, dimensions=(one.path,) * len(example.dimensions), required=False)
    kinds = " or ".join(sorted({f"{name_of(e.kind)} of {len(e.dimensions)} dimensions" for e in group.alike}))
    raise SchemaViolationError(_described(dataset), kinds)


def _check_storage(dataset: h5py.Dataset, file_bytes: int) -> int:
    """Check that a dataset is stored in the file itself; return its size in memory [bytes]."""
    if dataset.shape is None:
        raise SchemaViolationError("no data at all", "a value")
    creation = dataset.id.get_create_plist()
    kind = creation.get_layout()
    if kind == h5py.h5d.VIRTUAL or creation.get_external_count():
        raise SchemaViolationError("data that is stored elsewhere", "data in the file itself")
    filters = {creation.get_filter(i)[0] for i in range(creation.get_nfilters())}
    if not filters <= _FILTERS:
        raise SchemaViolationError(f"the HDF5 filters {sorted(filters)}", "shuffle and gzip only")
    count, stored = math.prod(dataset.shape), dataset.id.get_storage_size()
    size = int(count * dataset.dtype.itemsize)
    if stored > file_bytes:
        raise SchemaViolationError(f"{stored} stored bytes", f"at most the {file_bytes} of the file")
    if kind == h5py.h5d.CHUNKED:
        chunks = math.prod(-(-length // chunk) for length, chunk in zip(dataset.shape, dataset.chunks, strict=True))
        kept = dataset.id.get_num_chunks()
        if chunks != kept:
            raise SchemaViolationError(
                f"{kept} stored chunks of shape {dataset.chunks}", f"the {chunks} of shape {dataset.shape}"
            )
        size = int(chunks * math.prod(dataset.chunks) * dataset.dtype.itemsize)
    elif stored < size:
        raise SchemaViolationError(f"{stored} stored bytes", f"{size}, as its shape {dataset.shape} says")
    return size


def _check_shape(shapes: Mapping[str, tuple[int, ...]], one: ExpectedDataset) -> None:
    shape = shapes[one.path]
    if len(shape) != len(one.dimensions):
        raise SchemaViolationError(f"shape {shape}", f"{len(one.dimensions)} dimensions")
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
        raise SchemaViolationError(f"shape {shape}", f"{tuple(expected)}{as_long}")


def text_of(value: Any, where: str) -> str:
    # Lone surrogates represent invalid UTF-8.
    if not isinstance(value, str) or any("\ud800" <= sign <= "\udfff" for sign in value):
        raise SchemaViolationError(shown(value), "text in UTF-8", where)
    return value


def shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}.."


def _described(dataset: h5py.Dataset) -> str:
    kind = kind_of(dataset.dtype)
    return f"{name_of(kind) if kind else f'values of type {dataset.dtype}'} of shape {dataset.shape}"
