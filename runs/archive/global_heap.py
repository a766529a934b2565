"""Check of the global heaps of an HDF5 file, which hold texts: the HDF5 library never leaves one with an empty object.

Format: HDF5 File Format Specification 3.0, section III.E.
"""

from __future__ import annotations

import mmap
import re
import struct
from pathlib import Path

_COLLECTION = re.compile(rb"GCOL\x01\0\0\0")
_HEAD = struct.Struct("<8xQ")
"""Of a collection: signature and version, then its size with this head."""
_OBJECT = struct.Struct("<HHxxxxQ")
"""Before each object: index, number of references, size. Index 0 is the free rest, whose size includes this head."""
_ALIGNED = 8


class EndlessHeapError(Exception):
    """A global heap that no reader comes to the end of; the message has its place."""


def check(path: Path) -> None:
    """Follow each global heap of a file from object to object.

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
