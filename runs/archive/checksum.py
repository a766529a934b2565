"""The content of an archive as one SHA-256, over every dataset in the order of its path.

For each dataset: its path below the root, its kind (`f8`, `i8`, ..., `str`, `bytes`) and shape, then its values in C
order, little-endian; texts and pictures each preceded by their length in bytes (8 bytes, little-endian).
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.generic] | Iterable[bytes | memoryview]
_ROWS = 16384
"""Rows read at once from a dataset without chunks."""
PICTURE_ROWS = 64
"""Pictures read at once."""


@dataclass(frozen=True)
class Checksum:
    """The SHA-256 of an archive, and the CRC-32 of each of its datasets by path."""

    sha256: str
    parts: Mapping[str, int]


class ChecksumPart:
    """The CRC-32 of one dataset, fed some rows at a time."""

    def __init__(self, kind: str, shape: tuple[int, ...]) -> None:
        self.crc = zlib.crc32(f"{kind} {shape}".encode())

    def add(self, values: Values) -> None:
        """Take the next rows."""
        _feed(values, self._take)

    def _take(self, data: Any) -> None:
        self.crc = zlib.crc32(data, self.crc)


def kind_of(dtype: np.dtype[Any]) -> str:
    """Return the kind of numbers, whatever their order of bytes."""
    return str(dtype.str[1:])


def little(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return numbers in the byte order of the checksum."""
    return values.astype(values.dtype.newbyteorder("<"), copy=False)


def paths(file: h5py.File) -> list[str]:
    """Return the paths of every dataset of an open file, in order."""
    found: list[str] = []

    def visit(path: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset):
            found.append(path)

    file.visititems(visit)
    return sorted(found)


def of_file(file: h5py.File) -> Checksum:
    """Return the digest of what an open archive holds, read some rows at a time."""
    whole = hashlib.sha256()
    parts: dict[str, int] = {}
    for path in paths(file):
        # One dataset is open at a time: each has a cache of its own.
        node = file[path]
        kind, pieces = _read(node)
        shape = node.shape
        whole.update(f"{path} {kind} {shape}\n".encode())
        part = ChecksumPart(kind, shape)
        for values in pieces:
            _feed(values, whole.update)
            part.add(values)
        parts[path] = part.crc
    return Checksum(whole.hexdigest(), parts)


def _read(node: h5py.Dataset) -> tuple[str, Iterator[Values]]:
    """Return the kind of a dataset, and its values some rows at a time."""
    if h5py.check_string_dtype(node.dtype) is not None:
        return "str", ([word.encode() for word in np.atleast_1d(words)] for words in _slices(node.asstr(), node.shape))
    if h5py.check_vlen_dtype(node.dtype) is not None:
        return "bytes", ([picture.tobytes() for picture in some] for some in _slices(node, node.shape, PICTURE_ROWS))
    rows = node.chunks[0] if node.chunks else _ROWS
    pieces = (np.asarray(values) for values in _slices(node, node.shape, rows))
    return kind_of(node.dtype), (little(values) for values in pieces)


def _slices(node: Any, shape: tuple[int, ...], rows: int = _ROWS) -> Iterator[Any]:
    if shape == ():
        yield node[()]
        return
    for low in range(0, shape[0], rows):
        yield node[low : low + rows]


def _feed(values: Values, take: Callable[[Any], None]) -> None:
    if isinstance(values, np.ndarray):
        take(np.ascontiguousarray(values).data)
        return
    for item in values:
        take(len(item).to_bytes(8, "little"))
        take(item)
