"""External loads at the tip and along the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array


@dataclass(frozen=True, eq=False)
class Loads:
    """Dead loads in the base frame: they keep their direction while the arm moves.

    tip_force_n (3,) [N] and tip_moment_n_m (3,) [N m] act at the end of the arm (F^e, L^e of eq 28), the force at
    tip_point_m (3,) [m] of the tip's frame, a point that moves and turns with the tip; by default the end of the axis.
    force_n_per_m and moment_n_m_per_m act along it (f_e, l_e of eqs 12, 13) per metre at rest: (3,) for the same
    everywhere, or (K, 3) at K points spread evenly from base to tip, linear in between. The arrays are copied.
    Raises ValueError for numbers that are not finite and for other shapes.
    """

    tip_force_n: ArrayLike = (0.0, 0.0, 0.0)
    tip_moment_n_m: ArrayLike = (0.0, 0.0, 0.0)
    force_n_per_m: ArrayLike = (0.0, 0.0, 0.0)
    moment_n_m_per_m: ArrayLike = (0.0, 0.0, 0.0)
    tip_point_m: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("tip_force_n", "tip_moment_n_m", "tip_point_m"):
            vector = _vectors(name, getattr(self, name))
            if vector.ndim != 1:
                raise ValueError(f"{name} must be one vector of three numbers, got an array of shape {vector.shape}")
            object.__setattr__(self, name, vector)
        for name in ("force_n_per_m", "moment_n_m_per_m"):
            object.__setattr__(self, name, _vectors(name, getattr(self, name)))

    def tip(self) -> Array:
        """Force and moment at the tip, (6,)."""
        return np.concatenate([self.tip_force_n, self.tip_moment_n_m])

    def eccentric_force(self) -> Array:
        """The force at the tip and the point where it acts, (6,)."""
        return np.concatenate([self.tip_force_n, self.tip_point_m])

    def along(self, share: Array) -> Array:
        """Force and moment per metre (points, 6) at shares (points,) of the length of the arm."""
        columns = []
        for value in (self.force_n_per_m, self.moment_n_m_per_m):
            given = np.atleast_2d(value)
            at = np.linspace(0.0, 1.0, len(given))
            columns += [np.interp(share, at, column) for column in given.T]
        return np.stack(columns, axis=1)


def _vectors(name: str, value: ArrayLike) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.ndim not in (1, 2) or array.shape[-1] != 3 or array.size == 0:
        raise ValueError(f"{name} must be three numbers or rows of three, got an array of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array.tolist()}")
    array.flags.writeable = False
    return array
