"""The tip at rest: a tensor product of Chebyshev polynomials of the valves' pressures and the payload.

`coefficients` (8^V, m) have the pressure of the first valve as the slowest index. Beyond the range of a variable each
polynomial goes on along its tangent: a value stays consistent with its derivative, and a filter that linearises the map
is not drawn away from the range.
"""

from __future__ import annotations

import numpy as np

from model.arrays import Array
from rig.tip_control.kernels.compilation import compiled, internal

TERMS = 8
"""Polynomials of each pressure."""


@internal
def chebyshev_terms(x: float, values: Array, slopes: Array) -> None:
    """Write the Chebyshev polynomials (n,) of x and their derivatives; beyond -1 and 1 along the tangents there."""
    inside = min(max(x, -1.0), 1.0)
    values[0], slopes[0] = 1.0, 0.0
    if len(values) > 1:
        values[1], slopes[1] = inside, 1.0
    for n in range(2, len(values)):
        values[n] = 2 * inside * values[n - 1] - values[n - 2]
        slopes[n] = 2 * values[n - 1] + 2 * inside * slopes[n - 1] - slopes[n - 2]
    if inside != x:
        for n in range(len(values)):
            values[n] += slopes[n] * (x - inside)


@internal
def evaluate(
    coefficients: Array, pressure_pa: Array, limit_pa: float, with_slopes: bool, values: Array, slopes: Array
) -> None:
    """Write the sums (m,) at pressures (V,) and, if asked for, their derivatives (m, V) by the pressures [1/Pa]."""
    valves, columns = len(pressure_pa), coefficients.shape[1]
    terms, derivatives = np.empty(TERMS), np.empty(TERMS)
    size = coefficients.shape[0] // TERMS * columns
    # Row 0 is the sum of the polynomials; row 1 + v has the derivatives of the polynomials of valve v in their place.
    sums, reduced = np.zeros((valves + 1, size)), np.zeros((valves + 1, size))
    chebyshev_terms(2 / limit_pa * pressure_pa[0] - 1, terms, derivatives)
    flat = coefficients.reshape(TERMS, size)
    for k in range(TERMS):
        value, slope = terms[k], derivatives[k]
        for j in range(size):
            sums[0, j] += value * flat[k, j]
        if with_slopes:
            for j in range(size):
                sums[1, j] += slope * flat[k, j]
    for valve in range(1, valves):
        chebyshev_terms(2 / limit_pa * pressure_pa[valve] - 1, terms, derivatives)
        size //= TERMS
        rows = valve + 1 if with_slopes else 1
        for row in range(rows):
            reduced[row, :size] = 0.0
            for k in range(TERMS):
                value = terms[k]
                for j in range(size):
                    reduced[row, j] += value * sums[row, k * size + j]
        if with_slopes:
            reduced[rows, :size] = 0.0
            for k in range(TERMS):
                slope = derivatives[k]
                for j in range(size):
                    reduced[rows, j] += slope * sums[0, k * size + j]
        sums, reduced = reduced, sums
    for column in range(columns):
        values[column] = sums[0, column]
        if with_slopes:
            for valve in range(valves):
                slopes[column, valve] = 2 / limit_pa * sums[1 + valve, column]


@internal
def payload_terms(payload: float, terms: int) -> tuple[Array, Array]:
    """Polynomials (n,) of a payload relative to the largest of the map, and their derivatives."""
    values, slopes = np.empty(terms), np.empty(terms)
    chebyshev_terms(payload, values, slopes)
    return values, slopes


@internal
def weighted(coefficients: Array, weights: Array) -> Array:
    """The map (8^V, 3) that is the sum of those (8^V, 3 n) of n payload terms, times weights (n,)."""
    found = np.zeros((coefficients.shape[0], 3))
    for row in range(coefficients.shape[0]):
        for n in range(len(weights)):
            for axis in range(3):
                found[row, axis] += weights[n] * coefficients[row, 3 * n + axis]
    return found


@compiled
def map_of_payload(coefficients: Array, payload: float) -> Array:
    """The map (8^V, 3) under a payload relative to the largest of the map."""
    found: Array = weighted(coefficients, payload_terms(payload, coefficients.shape[1] // 3)[0])
    return found
