"""Small changes of an arm, its pressures or its tip wrench, with respect to which solutions are differentiated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.arm import Arm
from model.arrays import Array

GRADIENT_STEP_PA = 0.01
"""Step of a pressure for the gradient of a solution."""


@dataclass(frozen=True)
class TipWrench:
    """Dead forces (K, 3) [N] and moments (K, 3) [N m] in the base frame; the force at point_m (3,) of the tip frame.

    Raises ValueError for numbers that are not finite and for other shapes.
    """

    force_n: Array
    moment_n_m: Array
    point_m: Array

    def __post_init__(self) -> None:
        for name in ("force_n", "moment_n_m", "point_m"):
            given = np.array(getattr(self, name), dtype=np.float64)
            if not np.isfinite(given).all():
                raise ValueError(f"a tip wrench must be finite, got {name} {given.tolist()}")
            object.__setattr__(self, name, given)
        shapes = self.force_n.shape, self.moment_n_m.shape, self.point_m.shape
        if shapes != ((len(self.force_n), 3), (len(self.force_n), 3), (3,)):
            raise ValueError(f"a tip wrench must have forces and moments (K, 3) at a point (3,), got shapes {shapes}")


@dataclass(frozen=True)
class Variation:
    """A perturbed copy of an arm, for a forward difference of size `step` in any unit.

    arm: the perturbed arm, or the arm itself. pressure_pa (K, N), tip_wrench: perturbed pressures and wrenches; None
    for those of the arm. The step should be about 1e-7 of a large change.
    """

    step: float
    arm: Arm
    pressure_pa: Array | None = None
    tip_wrench: TipWrench | None = None
