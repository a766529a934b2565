"""The content of an archive as one SHA-256, over every dataset in the order of its path.

For each dataset: its path below the root, its kind (`f8`, `i8`, ..., `str`, `bytes`) and shape, then its values in C
order, little-endian; texts and pictures each preceded by their length in bytes (8 bytes, little-endian).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.generic] | Iterable[bytes | memoryview]
Content = tuple[str, tuple[int, ...], Values]
"""Kind, shape and values of a dataset."""


def of(contents: Mapping[str, Content]) -> str:
    """Return the digest of {path: content}."""
    digest = hashlib.sha256()
    for path in sorted(contents):
        kind, shape, values = contents[path]
        digest.update(f"{path} {kind} {shape}\n".encode())
        if isinstance(values, np.ndarray):
            digest.update(np.ascontiguousarray(values).data)
        else:
            for item in values:
                digest.update(len(item).to_bytes(8, "little"))
                digest.update(item)
    return digest.hexdigest()


def numbers(values: NDArray[np.generic]) -> Content:
    """Return an array as `of` takes it."""
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return little.dtype.str[1:], values.shape, little


def texts(values: Iterable[str], shape: tuple[int, ...]) -> Content:
    """Return texts as `of` takes them."""
    return "str", shape, [value.encode() for value in values]


def of_file(file: h5py.File) -> str:
    """Return the digest of what an open archive holds."""
    contents: dict[str, Content] = {}

    def visit(path: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset):
            contents[path] = _read(node)

    file.visititems(visit)
    return of(contents)


def _read(node: h5py.Dataset) -> Content:
    if h5py.check_string_dtype(node.dtype) is not None:
        values = node.asstr()[()]
        return texts([values] if node.shape == () else list(values), node.shape)
    if h5py.check_vlen_dtype(node.dtype) is not None:
        return "bytes", node.shape, (node[index].tobytes() for index in range(len(node)))
    return numbers(np.asarray(node[()]))
