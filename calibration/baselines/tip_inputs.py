"""What a baseline predicts tips from: lagged pressures and the force at the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identify.observations.poses import Poses
from calibration.identify.observations.pressure_lag import lagged_pa
from model.arrays import Array
from model.units import PA_PER_BAR


@dataclass(frozen=True)
class TipInputs:
    """Inputs of the K entries of one run that show the tip, and the tips.

    pressure_bar (K, N): behind a first-order lag. force_n (K, 3): weights and measured force, in the frame of the tips
    (K, 3) [m].
    """

    pressure_bar: Array
    force_n: Array
    tip_m: Array

    def __len__(self) -> int:
        return len(self.tip_m)

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> TipInputs:
        """The inputs of some entries."""
        return TipInputs(self.pressure_bar[chosen], self.force_n[chosen], self.tip_m[chosen])


def joined(parts: list[TipInputs]) -> TipInputs:
    """The entries of several runs in one table."""
    return TipInputs(
        np.concatenate([one.pressure_bar for one in parts]),
        np.concatenate([one.force_n for one in parts]),
        np.concatenate([one.tip_m for one in parts]),
    )


def inputs_of(poses: Poses, lag_s: float, gravity: tuple[float, float, float]) -> TipInputs:
    """The inputs of the entries with a tip; pressures behind a first-order lag [s], gravity [m/s^2]."""
    seen = poses.has_tip
    force = poses.wrench[:, :3] + poses.weight_kg[:, None] * np.asarray(gravity)
    return TipInputs(lagged_pa(poses, lag_s)[seen] / PA_PER_BAR, force[seen], poses.tip_m[seen])
