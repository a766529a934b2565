"""What drives an arm: which valve fills which actuators, and the limits of the pressures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.arrays import Array


@dataclass(frozen=True)
class Drive:
    """V valves that fill N actuators. Each pressure lies between 0 and `highest_pa` and changes by `rate_pa_s` at most.

    `actuators` has the indices (from 0) of the actuators of each valve.
    """

    actuators: tuple[tuple[int, ...], ...]
    highest_pa: float
    rate_pa_s: float

    @property
    def valves(self) -> int:
        """Number of valves."""
        return len(self.actuators)

    def matrix(self) -> Array:
        """Pressures of the actuators per pressure of the valves (N, V)."""
        matrix = np.zeros((sum(map(len, self.actuators)), self.valves))
        for valve, filled in enumerate(self.actuators):
            matrix[list(filled), valve] = 1.0
        return matrix

    def of_actuators(self, pressure_pa: Array) -> Array:
        """Pressures (.., V) of the valves from those of the actuators (.., N): the mean of each valve's actuators."""
        matrix = self.matrix()
        found: Array = pressure_pa @ (matrix / matrix.sum(axis=0))
        return found
