"""Pressure cycles, which soften a specimen (Mullins effect) and wear it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

THRESHOLD_BAR = 0.05
"""Least rise and fall of a cycle: five times the accuracy of the paper's sensors."""


def pressure_cycles(measured_bar: NDArray[np.float64]) -> int:
    """The number of pressure cycles in measured pressures (n, actuators), of the actuator that has most.

    A cycle is a rise by `THRESHOLD_BAR` or more, then a fall by `THRESHOLD_BAR` or more: turning points with a
    hysteresis. A level that is approached in steps is one rise. The valves make a run safe when it is over, so a rise
    that it ends with is a cycle, too. NaN is left out.
    """
    return max((_cycles(column[np.isfinite(column)].tolist()) for column in measured_bar.T), default=0)


def _cycles(pressures_bar: list[float]) -> int:
    count, rising = 0, False
    extreme = pressures_bar[0] if pressures_bar else 0.0
    for pressure in pressures_bar:
        if rising:
            extreme = max(extreme, pressure)
            turned = extreme - pressure >= THRESHOLD_BAR
        else:
            extreme = min(extreme, pressure)
            turned = pressure - extreme >= THRESHOLD_BAR
        if turned:
            count += rising
            rising, extreme = not rising, pressure
    return count + rising
