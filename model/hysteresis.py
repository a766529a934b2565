"""Rate-independent hysteresis of each actuator, by friction such as that between braid and wall.

Prandtl-Ishlinskii operator of stop elements (Maxwell-slip model): the effective pressure is P - sum_k w_k s_k. The stop
s_k follows P between -r_k and r_k, like a spring in series with a slider. P - s_k is a play operator of width r_k.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from model.actuation import StopElement
from model.arrays import Array
from model.kernels.hysteresis import slide


class Hysteresis:
    """The operator and its state; relaxed at first, at a pressure (N,) [Pa]."""

    def __init__(self, elements: Sequence[StopElement], pressure_pa: Array) -> None:
        self._elements = np.array([(one.weight, one.width_pa) for one in elements]).reshape(-1, 2)
        self._stops = np.zeros((len(elements), len(pressure_pa)))
        self._before = np.array(pressure_pa, dtype=np.float64)

    def advance(self, pressure_pa: Array) -> Array:
        """Effective pressures (T, N) of a sequence of pressures (T, N) [Pa], which must be finite."""
        if not len(self._elements):
            return pressure_pa
        effective = np.empty_like(pressure_pa)
        slide(self._elements, self._stops, self._before, pressure_pa, effective)
        return effective

    @property
    def state(self) -> tuple[Array, Array]:
        """The stops (K, N) and the last pressures (N,) [Pa], which `advance` changes in place."""
        return self._stops, self._before


def effective_pa(elements: Sequence[StopElement], pressure_pa: Array) -> Array:
    """Effective pressures (1 + T, N) of a sequence (1 + T, N) [Pa] from the relaxed state."""
    return Hysteresis(elements, pressure_pa[0]).advance(pressure_pa)
