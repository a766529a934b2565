"""Small changes of an arm, its pressures or its tip wrench, to which the tip's answer is asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.arm import Arm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TipWrench:
    """Dead forces (K, 3) [N] and moments (K, 3) [N m] in the base frame; the force at point_m (3,) of the tip frame.

    Raises ValueError for what is not finite or of another shape.
    """

    force_n: Array
    moment_n_m: Array
    point_m: Array

    def __post_init__(self) -> None:
        for name in ("force_n", "moment_n_m", "point_m"):
            given = np.array(getattr(self, name), dtype=np.float64)
            if not np.isfinite(given).all():
                raise ValueError(f"what pulls must be finite, got {name} {given.tolist()}")
            object.__setattr__(self, name, given)
        shapes = self.force_n.shape, self.moment_n_m.shape, self.point_m.shape
        if shapes != ((len(self.force_n), 3), (len(self.force_n), 3), (3,)):
            raise ValueError(f"what pulls must have forces and moments (K, 3) at a point (3,), got shapes {shapes}")


@dataclass(frozen=True)
class Variation:
    """One neighbour of an arm: the same but for a change of size `step`, in whatever unit.

    arm: with the change in it, or as it was. pressure_pa (K, N), pull: with the change in them; None where as they
    were. The step should be about 1e-7 of what would be a large change.
    """

    step: float
    arm: Arm
    pressure_pa: Array | None = None
    pull: TipWrench | None = None
