"""Checks of gauge pressures: shape, finiteness and unit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from model.arm import Arm
from model.arrays import Array

VACUUM_PA = -101_325.0
HIGHEST_PA = 1e8
LEAST_BAR, MOST_BAR = 0.01, 10.0
"""Numbers in this range with at most three decimals are bar; a measured pressure near zero has more digits."""


def pressures(arm: Arm, pressure_pa: ArrayLike) -> Array:
    """The pressures as an array (N,) [Pa]; ValueError unless they are N finite numbers."""
    pressure = np.array(pressure_pa, dtype=np.float64)
    if pressure.shape != (arm.actuators,):
        raise ValueError(f"pressure_pa must hold {arm.actuators} numbers, got shape {pressure.shape}")
    if not all(map(math.isfinite, pressure.tolist())):
        raise ValueError(f"pressures must be finite, got {pressure.tolist()} Pa")
    return pressure


def refuse_other_units(pressure_pa: Array) -> None:
    """Refuse gauge pressures (N,) [Pa] that are plausible only in another unit.

    Raises:
        ValueError: a pressure lies below vacuum or above any soft arm's, or all are round numbers of bar.
    """
    # With plain floats: NumPy takes longer for three numbers than a static solution.
    given = pressure_pa.tolist()
    if min(given) < VACUUM_PA:
        raise ValueError(f"gauge pressures below vacuum: {given} Pa, expected {VACUUM_PA:g} Pa or more")
    used = [abs(value) for value in given if value != 0]
    if used and max(used) > HIGHEST_PA:
        raise ValueError(f"pressures of {max(used):g} Pa, expected at most {HIGHEST_PA:g} Pa: was bar converted twice?")
    in_range = all(LEAST_BAR <= value <= MOST_BAR and abs(value - round(value, 3)) < 1e-12 for value in used)
    if in_range and any(value % 1 for value in used):
        raise ValueError(f"pressures are in pascal, and {given} look like bar: multiply by 1e5")
