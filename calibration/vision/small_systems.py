"""Compiled solution of small linear systems: NumPy's would load numba's compiler and SciPy for a kernel on the disk."""

from __future__ import annotations

from functools import partial

from model.arrays import Array
from model.kernels.jit import kernel

_LEAST_PIVOT = 1e-12

exact_kernel = partial(kernel, sources=(__file__,), fastmath=False)


@exact_kernel
def solve(matrix: Array, right: Array) -> bool:
    """Solve a small symmetric positive system in place by Gauss-Jordan; `matrix` becomes its inverse."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = matrix[k, k]
        if not pivot > _LEAST_PIVOT:
            return False
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        right[k] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
                right[i] -= factor * right[k]
    return True
