"""Kernel of the stop elements of the actuators."""

from __future__ import annotations

from typing import Any

from model.kernels.vec3 import called

Array = Any


@called
def slide(elements: Array, stops: Array, before: Array, pressure: Array, effective: Array) -> None:
    """Apply the stop elements to a sequence of pressures (T, N); fills the effective ones.

    elements (K, 2): weight and width. stops (K, N) and before (N,), the last pressures, are advanced.
    """
    for t in range(pressure.shape[0]):
        for n in range(pressure.shape[1]):
            change = pressure[t, n] - before[n]
            total = pressure[t, n]
            for k in range(elements.shape[0]):
                width = elements[k, 1]
                stop = min(max(stops[k, n] + change, -width), width)
                stops[k, n] = stop
                total -= elements[k, 0] * stop
            effective[t, n] = total
            before[n] = pressure[t, n]
