"""Damaged copies of an archive: through HDF5, or byte by byte."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from tests.support.archive_nodes import Random
from tests.support.content_mutations import CONTENT
from tests.support.storage_mutations import STORAGE


def flipped(data: bytearray, random: Random) -> str:
    """Single bits, most of them in the first part, where HDF5 keeps much of the structure."""
    places = random.integers(len(data), size=int(random.integers(1, 20)))
    for place in places:
        data[place] ^= 1 << int(random.integers(8))
    return f"{len(places)} bits"


def overwritten(data: bytearray, random: Random) -> str:
    """A stretch of zeros, ones or noise."""
    size = int(random.integers(1, 600))
    place = int(random.integers(max(1, len(data) - size)))
    data[place : place + size] = [bytes(size), b"\xff" * size, random.bytes(size)][random.integers(3)]
    return f"{size} bytes at {place}"


def truncated(data: bytearray, random: Random) -> str:
    """The end is missing."""
    size = int(random.integers(len(data)))
    del data[size:]
    return f"{size} bytes are left"


def moved(data: bytearray, random: Random) -> str:
    """Some bytes are missing or twice there."""
    size = int(random.integers(1, 64))
    place = int(random.integers(max(1, len(data) - size)))
    if random.random() < 0.5:
        del data[place : place + size]
        return f"{size} bytes are missing at {place}"
    data[place:place] = data[place : place + size]
    return f"{size} bytes are twice at {place}"


STRUCTURE = CONTENT + STORAGE
BYTES: tuple[Callable[[bytearray, Random], str], ...] = (flipped, overwritten, truncated, moved)


def mutant(
    source: Path, target: Path, seed: int, mutations: tuple[Callable[..., str], ...] = CONTENT + STORAGE + BYTES
) -> str:
    """Write a damaged copy of an archive and say what was done; the same for the same seed."""
    random = np.random.default_rng(seed)
    mutate = mutations[int(random.integers(len(mutations)))]
    data = bytearray(source.read_bytes())
    if mutate in BYTES:
        said = mutate(data, random)
        target.write_bytes(data)
    else:
        target.write_bytes(data)
        with h5py.File(target, "r+") as file:
            said = mutate(file, random)
    return f"{mutate.__name__}: {said}"
