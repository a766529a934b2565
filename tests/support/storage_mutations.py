"""Ways to damage how an archive is stored: links, outside files, declared sizes, chunks, filters."""

from __future__ import annotations

import zlib
from typing import Any

import h5py
import numpy as np

from tests.support.archive_nodes import Mutation, Random, chosen, datasets, groups, is_text, of, replaced


def soft_link(file: h5py.File, random: Random) -> str:
    path = str(random.choice([*datasets(file), *groups(file)]))
    target = str(random.choice(["/nowhere", f"/{path}", "/entry/tip/time", "/entry", "/"]))
    del file[path]
    file[path] = h5py.SoftLink(target)
    return f"{path} -> {target}"


def external_link(file: h5py.File, random: Random) -> str:
    path = str(random.choice([*datasets(file), *groups(file)]))
    target = str(random.choice(["/nowhere.h5", "other.h5", "/dev/zero", "/proc/self/mem"]))
    del file[path]
    file[path] = h5py.ExternalLink(target, "/")
    return f"{path} -> {target}"


def cycle(file: h5py.File, random: Random) -> str:
    path = str(random.choice(groups(file)))
    file[f"{path}/again"] = file["entry"]
    return path


def hard_link(file: h5py.File, random: Random) -> str:
    one, other = random.choice(datasets(file), 2, replace=False)
    del file[one]
    file[one] = file[other]
    return f"{one} = {other}"


def virtual(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.ndim)
    shape, kind = file[path].shape, file[path].dtype
    del file[path]
    layout = h5py.VirtualLayout(shape, kind)
    layout[...] = h5py.VirtualSource(str(random.choice(["other.h5", "."])), "/entry/tip/time", shape)
    file.create_virtual_dataset(path, layout)
    return path


def stored_outside(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.ndim)
    shape, kind = file[path].shape, file[path].dtype
    replaced(file, path, shape=shape, dtype=kind, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)])
    return path


def huge(file: h5py.File, random: Random) -> str:
    """Many rows that are declared and not stored, in one dataset or in a whole group."""
    rows = int(random.choice([2_000_000_000, 40_000_000_000, 2**62]))
    one = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.ndim)
    group = one.rpartition("/")[0]
    paths = [one]
    if random.random() < 0.5:
        length = file[one].shape[0]
        paths = [path for path in datasets(file) if path.startswith(f"{group}/") and file[path].shape[:1] == (length,)]
    for path in paths:
        inner, kind = file[path].shape[1:], file[path].dtype
        shape = (rows, *inner)
        fill: dict[str, Any] = {} if kind.kind == "O" else {"fillvalue": 1}
        chunks = (1000, *shape[1:]) if random.random() < 0.8 else None
        try:
            replaced(file, path, shape=shape, dtype=kind, chunks=chunks, **fill)
        except (ValueError, OSError, MemoryError):
            replaced(file, path, shape=(1, *inner), dtype=kind)
    return f"{paths}: {rows}"


def bomb(file: h5py.File, random: Random) -> str:
    """Zeros that are compressed to almost nothing, stored in full."""
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.ndim)
    rows, kind = 1_000_000, file[path].dtype
    shape = (int(random.choice([20, 2000])) * rows, *file[path].shape[1:])
    chunk = (rows, *shape[1:])
    node = replaced(file, path, shape=shape, dtype=kind, chunks=chunk, compression=9)
    packed = zlib.compress(bytes(rows * int(np.prod(shape[1:])) * kind.itemsize), 9)
    for low in range(0, shape[0], rows):
        node.id.write_direct_chunk((low, *(0 for _ in shape[1:])), packed)
    return f"{path}: {shape}"


def large_chunk(file: h5py.File, random: Random) -> str:
    path = of(
        file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.ndim == 1 and node.size
    )
    data = np.asarray(file[path][()])
    chunk = int(random.choice([20_000_000, 2_000_000]))
    node = replaced(
        file, path, shape=data.shape, dtype=data.dtype, maxshape=(None,), chunks=(chunk,), compression="gzip"
    )
    node[...] = data
    return path


def other_filter(file: h5py.File, random: Random) -> str:
    path = of(file, random, lambda node: not is_text(node) and node.dtype.kind in "iuf" and node.ndim and node.size)
    data = np.asarray(file[path][()])
    options = [{"compression": "lzf"}, {"scaleoffset": 3}, {"fletcher32": True}, {"chunks": True}]
    option: Any = options[random.integers(len(options))]
    replaced(file, path, data=data, **option)
    return f"{path}: {option}"


def no_space(file: h5py.File, random: Random) -> str:
    path = chosen(file, random)
    kind = file[path].dtype
    del file[path]
    file[path] = h5py.Empty(kind if kind.kind in "iuf" else "f8")
    return path


STORAGE: tuple[Mutation, ...] = (
    soft_link,
    external_link,
    cycle,
    hard_link,
    virtual,
    stored_outside,
    huge,
    bomb,
    large_chunk,
    other_filter,
    no_space,
)
