"""Small dense linear algebra for the kernels: 6 x 6 solves and a scaled Gram-Schmidt."""

from __future__ import annotations

from typing import Any

from model.kernels.vec3 import any_order, leaf

Array = Any


@leaf
def solve_six(a: Array, b: Array) -> bool:
    """Solve a x = b in place (a is destroyed, b becomes x) by elimination with row pivots; False when singular."""
    n = 6
    for i in range(n):
        p, best = i, abs(a[i, i])
        for r in range(i + 1, n):
            size = abs(a[r, i])
            if size > best:
                p, best = r, size
        # Written so that a NaN is refused too.
        if not best > 1e-300:
            return False
        if p != i:
            for c in range(i, n):
                a[i, c], a[p, c] = a[p, c], a[i, c]
            b[i], b[p] = b[p], b[i]
        over = 1.0 / a[i, i]
        a[i, i] = over
        for r in range(i + 1, n):
            f = a[r, i] * over
            for c in range(i + 1, n):
                a[r, c] -= f * a[i, c]
            b[r] -= f * b[i]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for c in range(i + 1, n):
            total -= a[i, c] * b[c]
        b[i] = total * a[i, i]
    return True


@leaf
def solve_six_rows(a: Array, b: Array) -> bool:
    """Solve a x = b (6, 6) for every row of b (P, 6), in place; False when singular."""
    n = 6
    for i in range(n):
        p, best = i, abs(a[i, i])
        for r in range(i + 1, n):
            if abs(a[r, i]) > best:
                p, best = r, abs(a[r, i])
        # Written so that a NaN is refused too.
        if not best > 1e-300:
            return False
        if p != i:
            for c in range(n):
                a[i, c], a[p, c] = a[p, c], a[i, c]
            for f in range(b.shape[0]):
                b[f, i], b[f, p] = b[f, p], b[f, i]
        over = 1.0 / a[i, i]
        for r in range(i + 1, n):
            share = a[r, i] * over
            for c in range(i + 1, n):
                a[r, c] -= share * a[i, c]
            for f in range(b.shape[0]):
                b[f, r] -= share * b[f, i]
    for f in range(b.shape[0]):
        for i in range(n - 1, -1, -1):
            total = b[f, i]
            for c in range(i + 1, n):
                total -= a[i, c] * b[f, c]
            b[f, i] = total / a[i, i]
    return True


@any_order
def orthonormalise(y: Array, r: Array) -> bool:
    """Factor y (six rows of 16, each a direction) into orthonormal rows and an upper triangle r, both in place.

    Afterwards old row k = sum over i <= k of r[i, k] * new row i. False when the rows are dependent.
    """
    rows, size = y.shape
    for k in range(rows):
        for i in range(k):
            dot = 0.0
            for c in range(size):
                dot += y[i, c] * y[k, c]
            r[i, k] = dot
            for c in range(size):
                y[k, c] -= dot * y[i, c]
        norm = 0.0
        for c in range(size):
            norm += y[k, c] * y[k, c]
        norm = norm**0.5
        if not norm > 1e-300:
            return False
        r[k, k] = norm
        over = 1.0 / norm
        for c in range(size):
            y[k, c] *= over
    return True
