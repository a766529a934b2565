"""Predicted tips: what a setup makes of the pressures and weights of some poses."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import model
from calibration.identify.data import Poses
from calibration.identify.parameters import Setup
from calibration.identify.smooth import between
from model.batch import statics

Array = NDArray[np.float64]
Solved = tuple[Array, Array]
"""Tips (K, 3) and orientations (K, 3, 3)."""
Key = tuple[object, ...]

BATCHED = ("linear", "pointwise")

# Time steps per camera period: at one step the time scheme's own damping would pass for the material's.
SUBSTEPS = 2
# Where inertia is asked for: two steps slow the arm's own oscillation, and a density came out 16 % too low.
FINE_SUBSTEPS = 8
_KEPT = 64
# The lever from the axis to the measured point turns with the tip: it is found anew until it stands still.
_LEVER_PASSES, _LEVER_STILL = 40, 1e-7
_SENSITIVITIES = 40
_PRESSURE_STEP_PA = 500.0


@dataclass
class Predictor:
    """Predicts the tips of one `Poses`; keeps the last solved shapes, because mounting and tool need no new ones."""

    poses: Poses
    substeps: int = SUBSTEPS
    _solved: dict[Key, Solved] = field(default_factory=dict)

    def __call__(self, setup: Setup) -> Array:
        """Tips (K, 3) [m] as they would be measured; NaN where the model has no solution."""
        return self.many([setup])[0]

    def many(self, setups: Sequence[Setup]) -> list[Array]:
        """Tips (K, 3) of each setup; what has not been solved yet is solved together, on all cores."""
        keys = [self._key(setup) for setup in setups]
        new = {key: setup for key, setup in zip(keys, setups, strict=True) if key not in self._solved}
        found = {key: self._solved[key] for key in keys if key in self._solved}
        if new:
            solve = _pulled if self.poses.wrench.any() else _moving if self.poses.moving else _resting
            pressures = [self._pressure(setup) for setup in new.values()]
            found |= zip(new, solve(list(new.values()), pressures, self.poses, self.substeps), strict=True)
        out = [setup.measured(*found[key]) for key, setup in zip(keys, setups, strict=True)]
        self._solved = dict(list({**self._solved, **found}.items())[-_KEPT:])
        return out

    def _key(self, setup: Setup) -> Key:
        # A wrench acts at the measured point, in the measurements' frame: then mounting and tool change the shape.
        mount = (setup.base_rotation_rad, setup.tool_offset_m) if self.poses.wrench.any() else ()
        return setup.turned_arm, setup.sensor_offset_pa, setup.sensor_gain, setup.sensor_lag_s, mount

    def _pressure(self, setup: Setup) -> Array:
        """True pressures (K, N)."""
        pressure = self.poses.pressure_pa
        if setup.sensor_lag_s and self.poses.moving and len(pressure) > 1:
            pressure = pressure + setup.sensor_lag_s * np.gradient(pressure, self.poses.period_s, axis=0)
        return setup.pressure_pa(pressure)

    def pressure_covariance(self, setup: Setup) -> Array:
        """Covariance (K, 3, 3) [m^2] that random pressure errors lend the predictions, by the arm's statics."""
        poses = self.poses
        if not poses.pressure_std_pa.any():
            return np.zeros((len(poses), 3, 3))
        some = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _SENSITIVITIES)).round().astype(int))
        at = setup.pressure_pa(poses.pressure_pa[some])
        steps = _PRESSURE_STEP_PA * np.concatenate([np.eye(poses.actuators), -np.eye(poses.actuators)])
        rows = (at[:, None, :] + steps).reshape(-1, poses.actuators)
        each = np.repeat(some, len(steps))
        tips = at_rest([setup.turned_arm], rows, poses.weight_kg[each])[0].reshape(len(some), -1, 3)
        high, low = tips[:, : poses.actuators], tips[:, poses.actuators :]
        slope = np.nan_to_num((high - low) / (2 * _PRESSURE_STEP_PA))
        nearest = np.abs(np.arange(len(poses))[:, None] - some).argmin(axis=1)
        spread = slope[nearest] * poses.pressure_std_pa[:, :, None]
        out: Array = np.swapaxes(spread, 1, 2) @ spread
        return out


def _loads(arm: model.Arm, weight_kg: float) -> model.Loads | None:
    if weight_kg == 0:
        return None
    x, y, z = arm.gravity_m_s2
    return model.Loads(tip_force_n=(weight_kg * x, weight_kg * y, weight_kg * z))


def _resting(setups: Sequence[Setup], pressure_pa: Sequence[Array], poses: Poses, _: int) -> list[Solved]:
    count = len(poses)
    each = [arm for setup in setups for arm in [setup.turned_arm] * count]
    tips, turned = at_rest(each, np.concatenate(pressure_pa), np.tile(poses.weight_kg, len(setups)))
    return [(tips[k : k + count], turned[k : k + count]) for k in range(0, len(tips), count)]


def at_rest(arms: Sequence[model.Arm], pressure_pa: Array, weight_kg: Array) -> Solved:
    """Tips (B, 3) and orientations (B, 3, 3) under rows of pressures (B, N) and weights (B,); NaN where none is found.

    arms: one for every row, or one for all.
    """
    # At rest a weight on the cap is a heavier cap.
    loaded = [
        arm if weight == 0 else replace(arm, cap_mass_kg=arm.cap_mass_kg + weight)
        for arm, weight in zip(itertools.cycle(arms), weight_kg.tolist(), strict=False)
    ]
    if arms[0].section_rule in BATCHED:
        tips = statics(loaded, pressure_pa)
        return tips.tip_m, tips.tip_rotation
    place, turned = np.full((len(loaded), 3), np.nan), np.full((len(loaded), 3, 3), np.nan)
    for k, (arm, pressure) in enumerate(zip(loaded, pressure_pa, strict=True)):
        with suppress(model.NotConverged):
            shape = arm.statics(pressure)
            place[k], turned[k] = shape.tip_m, shape.tip_rotation
    return place, turned


def _moving(setups: Sequence[Setup], pressure_pa: Sequence[Array], poses: Poses, substeps: int) -> list[Solved]:
    arms = [setup.turned_arm for setup in setups]
    with ThreadPoolExecutor(min(len(arms), os.cpu_count() or 1)) as pool:
        return list(pool.map(_motion, arms, pressure_pa, itertools.repeat(poses), itertools.repeat(substeps)))


def _pulled(setups: Sequence[Setup], pressure_pa: Sequence[Array], poses: Poses, substeps: int) -> list[Solved]:
    """Under measured wrenches, one pose at a time: the lever of the force turns with the tip."""
    return [_under_wrench(setup, rows, poses, substeps) for setup, rows in zip(setups, pressure_pa, strict=True)]


def _under_wrench(setup: Setup, pressure_pa: Array, poses: Poses, substeps: int) -> Solved:
    arm, count = setup.turned_arm, len(poses)
    tips, turned = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    back = Rotation.from_rotvec(setup.base_rotation_rad).inv()
    force, moment = back.apply(poses.wrench[:, :3]), back.apply(poses.wrench[:, 3:])
    tool, gravity = np.array(setup.tool_offset_m), np.array(arm.gravity_m_s2)
    dynamics = arm.dynamics(poses.period_s / substeps) if poses.moving else None
    rotation, before = np.eye(3), None

    def loads(k: int) -> model.Loads:
        pull = force[k] + poses.weight_kg[k] * gravity
        return model.Loads(tip_force_n=pull, tip_moment_n_m=moment[k] + np.cross(rotation @ tool, force[k]))

    for k in range(count):
        try:
            if dynamics is None or before is None:
                for _ in range(_LEVER_PASSES):
                    shape = arm.statics(pressure_pa[k], loads(k))
                    turn, rotation = np.abs(shape.tip_rotation - rotation).max(), shape.tip_rotation
                    if turn < _LEVER_STILL:
                        break
                if dynamics is not None:
                    shape = dynamics.start(pressure_pa[k], loads(k))
            else:
                for part in range(1, substeps + 1):
                    share = part / substeps
                    shape = dynamics.step((1 - share) * before + share * pressure_pa[k], loads(k))
                    rotation = shape.tip_rotation
        except model.NotConverged:
            rotation = np.eye(3)
            continue
        before = pressure_pa[k]
        if shape.ok:
            tips[k], turned[k] = shape.tip_m, shape.tip_rotation
    return tips, turned


def _motion(arm: model.Arm, pressure_pa: Array, poses: Poses, substeps: int) -> Solved:
    tips, turned = np.full((len(poses), 3), np.nan), np.full((len(poses), 3, 3), np.nan)
    dynamics = arm.dynamics(poses.period_s / substeps)
    weight = poses.weight_kg
    try:
        shape = dynamics.start(pressure_pa[0], _loads(arm, weight[0]))
    except model.NotConverged:
        return tips, turned
    tips[0], turned[0] = shape.tip_m, shape.tip_rotation
    path = between(pressure_pa, substeps)
    changes = np.flatnonzero(np.diff(weight)) + 1
    for start, stop in itertools.pairwise([1, *changes[changes > 1].tolist(), len(poses)]):
        rows = path[start - 1 : stop - 1].reshape(-1, poses.actuators)
        # The first step takes up what hangs there; the others go on with it.
        dynamics.step(rows[0], _loads(arm, weight[start]))
        motion = dynamics.run(rows[1:])
        good = motion.ok[substeps - 2 :: substeps]
        tips[start:stop][good] = motion.tip_m[substeps - 2 :: substeps][good]
        turned[start:stop][good] = motion.tip_rotation[substeps - 2 :: substeps][good]
    return tips, turned
