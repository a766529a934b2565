"""Gauge pressures as callers give them: shape, finiteness and unit are checked before any kernel sees them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arm import Arm

Array = NDArray[np.float64]

VACUUM_PA = -101_325.0
HIGHEST_PA = 1e8
LEAST_BAR, MOST_BAR = 0.01, 10.0
"""Numbers from here to there with at most three decimals are bar; a measured pressure near zero has more digits."""


def pressures(arm: Arm, pressure_pa: ArrayLike) -> Array:
    """The pressures as an array (N,), or ValueError when they are not N finite numbers."""
    pressure = np.array(pressure_pa, dtype=np.float64)
    if pressure.shape != (arm.geometry.actuators,):
        raise ValueError(f"pressure_pa must hold {arm.geometry.actuators} numbers, got shape {pressure.shape}")
    if not all(map(math.isfinite, pressure.tolist())):
        raise ValueError(f"pressures must be finite, got {pressure.tolist()} Pa")
    return pressure


def refuse_other_units(pressure_pa: Array) -> None:
    """Refuse gauge pressures (N,) that no arm has in pascal.

    Raises:
        ValueError: a pressure lies below vacuum or above any soft arm's, or all are round numbers of bar.
    """
    if np.any(pressure_pa < VACUUM_PA):
        raise ValueError(f"gauge pressures below vacuum: {pressure_pa.tolist()} Pa, expected {VACUUM_PA:g} Pa or more")
    highest = float(np.abs(pressure_pa).max(initial=0.0))
    if highest > HIGHEST_PA:
        raise ValueError(f"pressures of {highest:g} Pa, expected at most {HIGHEST_PA:g} Pa: was bar converted twice?")
    used = np.abs(pressure_pa[pressure_pa != 0])
    rounded = np.all(np.abs(used - np.round(used, 3)) < 1e-12)
    if len(used) and rounded and np.all((used >= LEAST_BAR) & (used <= MOST_BAR)) and np.any(used % 1):
        raise ValueError(f"pressures are in pascal, and {pressure_pa.tolist()} look like bar: multiply by 1e5")
