"""Loads from outside: what pulls at the tip and along the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Loads:
    """Dead loads in the base frame: they keep their direction while the arm moves.

    tip_force_n (3,) [N] and tip_moment_n_m (3,) [N m] act at the end of the arm's axis (F^e, L^e of eq 28).
    force_n_per_m and moment_n_m_per_m act along it (f_e, l_e of eqs 12, 13) per metre at rest: (3,) for the same
    everywhere, or (K, 3) at K points spread evenly from base to tip, linear in between.
    """

    tip_force_n: ArrayLike = (0.0, 0.0, 0.0)
    tip_moment_n_m: ArrayLike = (0.0, 0.0, 0.0)
    force_n_per_m: ArrayLike = (0.0, 0.0, 0.0)
    moment_n_m_per_m: ArrayLike = (0.0, 0.0, 0.0)

    def tip(self) -> Array:
        """Force and moment at the tip, (6,)."""
        force, moment = _vectors("tip_force_n", self.tip_force_n), _vectors("tip_moment_n_m", self.tip_moment_n_m)
        if force.ndim != 1 or moment.ndim != 1:
            raise ValueError("a load at the tip is one vector of three numbers")
        return np.concatenate([force, moment])

    def along(self, points: int) -> Array:
        """Force and moment per metre at evenly spaced points, (points, 6)."""
        columns = []
        for name, value in (("force_n_per_m", self.force_n_per_m), ("moment_n_m_per_m", self.moment_n_m_per_m)):
            given = np.atleast_2d(_vectors(name, value))
            at = np.linspace(0.0, 1.0, len(given))
            columns += [np.interp(np.linspace(0.0, 1.0, points), at, column) for column in given.T]
        return np.stack(columns, axis=1)


def _vectors(name: str, value: ArrayLike) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim not in (1, 2) or array.shape[-1] != 3 or array.size == 0:
        raise ValueError(f"{name} must be three numbers or rows of three, got an array of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array.tolist()}")
    return array
