"""Datasets and groups of an archive that a mutation damages: listed, drawn at random, replaced."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

Random = np.random.Generator
Mutation = Callable[[h5py.File, Random], str]
"""Damages an open archive and says how."""


def datasets(file: h5py.File) -> list[str]:
    found: list[str] = []
    file.visititems(lambda name, node: found.append(name) if isinstance(node, h5py.Dataset) else None)
    return found


def groups(file: h5py.File) -> list[str]:
    found: list[str] = []
    file.visititems(lambda name, node: found.append(name) if isinstance(node, h5py.Group) else None)
    return found


def chosen(file: h5py.File, random: Random) -> str:
    return str(random.choice(datasets(file)))


def is_text(node: h5py.Dataset) -> bool:
    return h5py.check_string_dtype(node.dtype) is not None


def of(file: h5py.File, random: Random, wanted: Callable[[h5py.Dataset], bool]) -> str:
    return str(random.choice([name for name in datasets(file) if wanted(file[name])]))


def replaced(file: h5py.File, path: str, **options: Any) -> h5py.Dataset:
    """Replace a dataset by another one, keeping its attributes where possible."""
    kept = {}
    if path in file:
        kept = {name: file[path].attrs[name] for name in ("units", "description") if name in file[path].attrs}
        del file[path]
    node = file.create_dataset(path, **options)
    node.attrs.update(kept)
    return node
