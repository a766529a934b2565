"""Writes a MATLAB file of version 5: structs of numbers, texts and lists of texts.

After "MAT-File Format" of The MathWorks, level 5. SciPy would write it as well, and weighs more than all that an
archive is read with.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED, _UTF16 = 1, 5, 6, 14, 15, 17
_CELL, _STRUCT, _CHAR = 1, 2, 4
# (class of the array, type of its values) of NumPy's types
_NUMBERS = {
    "f8": (6, 9), "f4": (7, 7), "i1": (8, 1), "u1": (9, 2), "i2": (10, 3), "u2": (11, 4),
    "i4": (12, 5), "u4": (13, 6), "i8": (14, 12), "u8": (15, 13),
}  # fmt: skip
_NAME_BYTES = 64
"""Of the name of a field, with a zero at its end."""
_MOST_BYTES = 2**32 - 1


def write(path: Path, name: str, content: Mapping[str, Any]) -> None:
    """Write one variable, a struct: its values are structs, arrays, numbers, texts or lists of texts.

    Raises:
        ValueError: it is larger than the format allows, 4 GiB.
    """
    variable = _element(_COMPRESSED, zlib.compress(_matrix(content, name), 1), padded=False)
    with path.open("wb") as file:
        file.write(b"MATLAB 5.0 MAT-file, written by softrig".ljust(124) + struct.pack("<H2s", 0x0100, b"IM"))
        file.write(variable)


def _matrix(value: Any, name: str = "") -> bytes:
    """One array: of numbers, of the letters of a text, of texts, or a struct."""
    if isinstance(value, Mapping):
        names = b"".join(field.encode("ascii").ljust(_NAME_BYTES, b"\0") for field in value)
        fields = struct.pack("<HHi", _INT32, 4, _NAME_BYTES) + _element(_INT8, names)
        return _array(_STRUCT, (1, 1), name, fields + b"".join(map(_matrix, value.values())))
    if isinstance(value, str):
        letters = value.encode("utf-16-le", "replace")
        return _array(_CHAR, (1 if letters else 0, len(letters) // 2), name, _element(_UTF16, letters))
    if isinstance(value, Sequence):
        return _array(_CELL, (len(value), 1), name, b"".join(map(_matrix, value)))
    numbers: NDArray[Any] = np.asarray(value)
    kind, type_ = _NUMBERS[numbers.dtype.str[1:]]
    # A row of numbers is a column in MATLAB.
    shape = (*numbers.shape, 1, 1)[: max(2, numbers.ndim)]
    little = numbers.astype(numbers.dtype.newbyteorder("<"), copy=False)
    return _array(kind, shape, name, _element(type_, little.tobytes(order="F")))


def _array(kind: int, shape: Sequence[int], name: str, values: bytes) -> bytes:
    flags = _element(_UINT32, struct.pack("<II", kind, 0))
    dimensions = _element(_INT32, struct.pack(f"<{len(shape)}i", *shape))
    return _element(_MATRIX, flags + dimensions + _element(_INT8, name.encode("ascii")) + values)


def _element(type_: int, data: bytes, *, padded: bool = True) -> bytes:
    if len(data) > _MOST_BYTES:
        raise ValueError(f"{len(data)} bytes in one piece, at most {_MOST_BYTES}")
    return struct.pack("<II", type_, len(data)) + data + bytes(-len(data) % 8 if padded else 0)
