"""Exceptions of the model."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR


class SeveralSegments(ValueError):  # noqa: N818 - what was found is the name
    """An arm of several segments, where an arm of one is expected."""


class NotConverged(Exception):  # noqa: N818 - the outcome is the name
    """No equilibrium was found; the message says at which pressures."""

    @classmethod
    def at(cls, pressure_pa: NDArray[np.float64]) -> NotConverged:
        """The error at pressures (N,) [Pa]."""
        bar = ", ".join(f"{value / PA_PER_BAR:.4g}" for value in pressure_pa)
        return cls(f"no equilibrium found at {bar} bar: a pressure or load may be far outside the arm's range")


class Unstable(NotConverged):
    """Only an unstable equilibrium was found, which the arm buckles or snaps away from."""

    @classmethod
    def at(cls, pressure_pa: NDArray[np.float64]) -> Unstable:
        """The error at pressures (N,) [Pa]."""
        bar = ", ".join(f"{value / PA_PER_BAR:.4g}" for value in pressure_pa)
        return cls(f"no stable equilibrium found at {bar} bar: the arm buckles or snaps under these loads")
