"""Vectors and symmetric blocks as tuples of numbers, for the loops over lanes."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.kernels.jit import kernel
from model.kernels.layout import LANES

Array = Any
_ANY_ORDER = {"contract", "arcp", "nsz", "reassoc"}
Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


def inlined(function: Any) -> Any:
    """Compile a function into every caller: a loop with a call in it is not vectorised."""
    return kernel(function, inlined=True, allocates=False, called=False)


def leaf(function: Any) -> Any:
    """Compile a kernel that allocates no array and is called by kernels only."""
    return kernel(function, allocates=False, called=False)


def called(function: Any) -> Any:
    """Compile a kernel that allocates no array and is called from Python."""
    return kernel(function, allocates=False)


@inlined
def triple(w: Array, at: int, i: int) -> Triple:
    """Three quantities of lane i, from offset `at` on."""
    return w[at * LANES + i], w[(at + 1) * LANES + i], w[(at + 2) * LANES + i]


@inlined
def six(w: Array, at: int, i: int) -> Six:
    """Six quantities of lane i, from offset `at` on."""
    return (
        w[at * LANES + i], w[(at + 1) * LANES + i], w[(at + 2) * LANES + i],
        w[(at + 3) * LANES + i], w[(at + 4) * LANES + i], w[(at + 5) * LANES + i],
    )  # fmt: skip


@inlined
def put(w: Array, at: int, i: int, a: Triple) -> None:
    """Write three quantities of lane i, from offset `at` on."""
    w[at * LANES + i] = a[0]
    w[(at + 1) * LANES + i] = a[1]
    w[(at + 2) * LANES + i] = a[2]


@inlined
def three(a: Array, at: int) -> Triple:
    """Three consecutive numbers of an array."""
    # numba checks a signed index for counting from the end.
    first, second, third = np.uint64(at), np.uint64(at + 1), np.uint64(at + 2)
    return a[first], a[second], a[third]


@inlined
def cross(a: Triple, b: Triple) -> Triple:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def plus(a: Triple, s: float, b: Triple) -> Triple:
    """a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@inlined
def times(k: Six, a: Triple) -> Triple:
    """Symmetric block (11, 12, 13, 22, 23, 33) times a vector."""
    return (
        k[0] * a[0] + k[1] * a[1] + k[2] * a[2],
        k[1] * a[0] + k[3] * a[1] + k[4] * a[2],
        k[2] * a[0] + k[4] * a[1] + k[5] * a[2],
    )


@inlined
def rotation(h: tuple[float, float, float, float]) -> tuple[Triple, Triple, Triple]:
    """Columns of the rotation matrix of a quaternion of any norm: the axes of the section in the base frame."""
    a, b, c, d = h
    s = 2.0 / (a * a + b * b + c * c + d * d)
    return (
        (1.0 - s * (c * c + d * d), s * (b * c + d * a), s * (b * d - c * a)),
        (s * (b * c - d * a), 1.0 - s * (b * b + d * d), s * (c * d + b * a)),
        (s * (b * d + c * a), s * (c * d - b * a), 1.0 - s * (b * b + c * c)),
    )


@inlined
def dot(a: Triple, b: Triple) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def any_order(function: Any) -> Any:
    """Compile a leaf whose sums may be reordered; the compiler fixes the order once."""
    return kernel(function, fastmath=_ANY_ORDER, allocates=False, called=False)
