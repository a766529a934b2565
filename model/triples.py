"""Vectors and symmetric blocks as tuples of numbers, for the bodies of the kernels' loops over lanes."""

from __future__ import annotations

from typing import Any

from model.compiled import kernel
from model.layout import LANES

Array = Any
_ANY_ORDER = {"contract", "arcp", "nsz", "reassoc"}
Triple = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


def inlined(function: Any) -> Any:
    """Compile into every caller: a loop that calls is not made of vector instructions."""
    return kernel(function, inlined=True, allocates=False, called=False)


def leaf(function: Any) -> Any:
    """Compile a kernel that makes no array and that only kernels call."""
    return kernel(function, allocates=False, called=False)


def called(function: Any) -> Any:
    """Compile a kernel that makes no array and that Python calls."""
    return kernel(function, allocates=False)


@inlined
def triple(w: Array, at: int, i: int) -> Triple:
    """Three quantities of lane i that stand at `at` and after."""
    return w[at * LANES + i], w[(at + 1) * LANES + i], w[(at + 2) * LANES + i]


@inlined
def six(w: Array, at: int, i: int) -> Six:
    """Six quantities of lane i that stand at `at` and after."""
    return (
        w[at * LANES + i], w[(at + 1) * LANES + i], w[(at + 2) * LANES + i],
        w[(at + 3) * LANES + i], w[(at + 4) * LANES + i], w[(at + 5) * LANES + i],
    )  # fmt: skip


@inlined
def put(w: Array, at: int, i: int, a: Triple) -> None:
    """Write three quantities of lane i."""
    w[at * LANES + i] = a[0]
    w[(at + 1) * LANES + i] = a[1]
    w[(at + 2) * LANES + i] = a[2]


@inlined
def three(a: Array, at: int) -> Triple:
    """Three numbers in a row."""
    return a[at], a[at + 1], a[at + 2]


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
    """Columns of the rotation matrix of a quaternion of any length: the section's axes in the base frame."""
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
    """Compile a leaf whose sums may be taken in any order, which the compiler then fixes once and for all."""
    return kernel(function, fastmath=_ANY_ORDER, allocates=False, called=False)


def _lane_sums(weights: Array, s: int, a: Array, j: int) -> Any:
    """Row j of `a` with its lanes summed by row s of the weights: v, u, q, w and the first and the last three of h.

    Sixteen sums in one loop over the lanes, or they are not made of vector instructions.
    """
    v1 = v2 = v3 = u1 = u2 = u3 = q1 = q2 = q3 = o1 = o2 = o3 = h0 = h1 = h2 = h3 = 0.0
    for i in range(LANES):
        k = weights[s, i]
        v1 += k * a[j, i]
        v2 += k * a[j, LANES + i]
        v3 += k * a[j, 2 * LANES + i]
        u1 += k * a[j, 3 * LANES + i]
        u2 += k * a[j, 4 * LANES + i]
        u3 += k * a[j, 5 * LANES + i]
        q1 += k * a[j, 6 * LANES + i]
        q2 += k * a[j, 7 * LANES + i]
        q3 += k * a[j, 8 * LANES + i]
        o1 += k * a[j, 9 * LANES + i]
        o2 += k * a[j, 10 * LANES + i]
        o3 += k * a[j, 11 * LANES + i]
        h0 += k * a[j, 12 * LANES + i]
        h1 += k * a[j, 13 * LANES + i]
        h2 += k * a[j, 14 * LANES + i]
        h3 += k * a[j, 15 * LANES + i]
    return (v1, v2, v3), (u1, u2, u3), (q1, q2, q3), (o1, o2, o3), h0, (h1, h2, h3)


lane_sums = kernel(_lane_sums, fastmath=_ANY_ORDER, inlined=True, allocates=False, called=False)


@inlined
def write(a: Array, j: int, c: int, b: Triple) -> None:
    """Three numbers into row j, from c on."""
    a[j, c], a[j, c + 1], a[j, c + 2] = b


@inlined
def size(a: Triple) -> float:
    """The largest of three, all taken positive."""
    return max(max(abs(a[0]), abs(a[1])), abs(a[2]))


@inlined
def sum_of(a: Triple) -> float:
    """The sum of three, all taken positive."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])
