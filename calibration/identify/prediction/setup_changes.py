"""Derivatives of measured poses by changes of an arm and of its mounting, from those of the arm alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.identify.observations.orientation import Orientations
from calibration.identify.unknowns.setup import SectionMount, Setup
from calibration.rotation_vectors import inverse_right_jacobian, left_jacobian
from model.arrays import Array


def rotation_between(one: Array, other: Array) -> Array:
    """Rotation vectors (K, 3) [rad] in the outer frame that turn the orientations `other` into `one`; NaN as these."""
    relative = one @ np.swapaxes(other, 1, 2)
    known = np.isfinite(relative).all(axis=(1, 2))
    out = np.full((len(relative), 3), np.nan)
    if known.any():
        out[known] = Rotation.from_matrix(relative[known]).as_rotvec()
    return out


@dataclass(frozen=True)
class PoseDerivatives:
    """Poses of the tip or of a section in the rod-base frame, and their derivatives by the changes of the arm.

    point_m (K, 3), rotation (K, 3, 3); point_by and turn_by (K, 3, changes).
    """

    point_m: Array
    rotation: Array
    point_by: Array
    turn_by: Array


@dataclass(frozen=True)
class SetupChanges:
    """Changes of a setup: `perturbed` (P,) has one each, of the size `steps`; `new` are those that change the arm."""

    setup: Setup
    perturbed: Sequence[Setup]
    steps: Sequence[float]
    new: Sequence[int]

    def slopes(
        self, arm: PoseDerivatives, measured: Orientations | None, mount: Callable[[Setup], SectionMount]
    ) -> Array:
        """Derivatives of measured points, and of rotations if some were `measured`, (K, 3 or 6, P).

        mount: of a setup, how the measured frame is mounted.
        """
        setup, own = self.setup, mount(self.setup)
        base = Rotation.from_rotvec(setup.base_rotation_rad).as_matrix()
        by_base, by_mount = left_jacobian(np.array(setup.base_rotation_rad)), left_jacobian(np.array(own.rotation_rad))
        rotation, lever = arm.rotation, arm.rotation @ np.array(own.offset_m)
        moved, turned = (np.zeros((len(lever), 3, len(self.perturbed))) for _ in range(2))
        moved[:, :, self.new] = base @ (arm.point_by + np.cross(arm.turn_by, lever[:, :, None], axis=1))
        turned[:, :, self.new] = base @ arm.turn_by
        point = (arm.point_m + lever) @ base.T
        for k, (other, step) in enumerate(zip(self.perturbed, self.steps, strict=True)):
            there = mount(other)
            turn = by_base @ _rate(other.base_rotation_rad, setup.base_rotation_rad, step)
            offset, twist = _rate(there.offset_m, own.offset_m, step), _rate(there.rotation_rad, own.rotation_rad, step)
            shift = _rate(other.base_translation_m, setup.base_translation_m, step)
            moved[:, :, k] += shift + np.cross(turn, point) + (rotation @ offset) @ base.T
            turned[:, :, k] += turn + (rotation @ (by_mount @ twist)) @ base.T
        if measured is None:
            return moved
        apart = rotation_between(measured.rotation, setup.oriented(rotation, own))
        return np.concatenate([moved, inverse_right_jacobian(np.nan_to_num(apart)) @ turned], axis=1)


def _rate(there: Sequence[float], here: Sequence[float], step: float) -> Array:
    out: Array = (np.array(there) - np.array(here)) / step
    return out
