"""Broadcasts into all lanes, and sums over the lanes."""

from __future__ import annotations

from typing import Any

from model.kernels.layout import LANES, STATE
from model.kernels.vec3 import inlined

Array = Any


@inlined
def broadcast(w: Array, at: int, value: float) -> None:
    """Set quantity `at` of the work array to `value` in all lanes."""
    for i in range(LANES):
        w[at * LANES + i] = value


@inlined
def horizontal_sum(weights: Array, s: int, lanes: Array, j: int, x: Array, update: Array) -> None:
    """Set row j of x (.., 16) to lane 0 of row j of lanes (.., 128) plus its weighted sum by row s of weights.

    update (2, 16) keeps the largest absolute value of these sums, and their total, which a NaN always reaches.
    """
    for c in range(STATE):
        total = 0.0
        for i in range(LANES):
            total += weights[s, i] * lanes[j, c * LANES + i]
        x[j, c] = lanes[j, c * LANES] + total
        update[0, c] = max(update[0, c], abs(total))
        update[1, c] += abs(total)


@inlined
def horizontal_sum_slopes(weights: Array, s: int, lanes: Array, j: int, x: Array, to: int, update: Array) -> None:
    """Set row `to` of x likewise for derivatives of strains and velocities; update[1] adds up the results."""
    for c in range(STATE - 4):
        total = 0.0
        for i in range(LANES):
            total += weights[s, i] * lanes[j, c * LANES + i]
        here = lanes[j, c * LANES] + total
        x[to, c] = here
        update[1, c] += here
