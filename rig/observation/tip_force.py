"""The measured force on the tip, from the auxiliary inputs that the rig file declares as its components."""

from __future__ import annotations

import numpy as np

from model.arrays import Array
from rig.config.schema import RigConfig


class MeasuredTipForce:
    """Sums the components of the force, each along the direction of its input."""

    def __init__(self, config: RigConfig) -> None:
        declared = {name: one.tip_force_direction for name, one in config.inputs.items()}
        self.inputs = tuple(name for name, direction in declared.items() if direction is not None)
        """Names of the inputs that measure a component; none if the rig does not measure the force."""
        self._columns = [list(declared).index(name) for name in self.inputs]
        directions = np.array([declared[name] for name in self.inputs], dtype=np.float64).reshape(-1, 3)
        self._axes = directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def __bool__(self) -> bool:
        return bool(self.inputs)

    def of(self, values: Array) -> Array:
        """Force (k, 3) [N] on the arm in the rod-base frame from values of all inputs (k, I); NaN if one is missing."""
        return np.asarray(values[:, self._columns] @ self._axes)
