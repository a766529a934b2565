"""Predicted tips: what a setup makes of the pressures and weights of some poses."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import model
from calibration.identify.data import Poses
from calibration.identify.parameters import Setup
from calibration.identify.smooth import curve
from model import gradient
from model.gradient import Change, Pull

Array = NDArray[np.float64]
Solved = tuple[Array, Array]
"""Tips (K, 3) and orientations (K, 3, 3)."""
Key = tuple[object, ...]

# Time steps per camera period: at one step the time scheme's own damping would pass for the material's.
SUBSTEPS = 2
# Where inertia is asked for: two steps slow the arm's own oscillation, and a density came out 16 % too low.
FINE_SUBSTEPS = 8
_KEPT = 64
_SENSITIVITIES = 40


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
            solve = _moving if self.poses.moving else _resting
            pressures = [self._pressure(setup) for setup in new.values()]
            found |= zip(new, solve(list(new.values()), pressures, self.poses, self.substeps), strict=True)
        out = [setup.measured(*found[key]) for key, setup in zip(keys, setups, strict=True)]
        self._solved = dict(list({**self._solved, **found}.items())[-_KEPT:])
        return out

    def _key(self, setup: Setup) -> Key:
        # A wrench acts at the measured point, in the measurements' frame: then mounting and tool change the shape.
        mount = (setup.base_rotation_rad, setup.tool_offset_m) if self.poses.wrench.any() else ()
        return (
            setup.turned_arm,
            setup.sensor_offset_pa,
            setup.sensor_gain,
            setup.sensor_lag_s,
            setup.sensor_filter_s,
            mount,
        )

    def _pressure(self, setup: Setup) -> Array:
        """True pressures: of poses (K, N), or of a motion's start and each of its steps (1 + (K - 1) substeps, N)."""
        poses = self.poses
        if not poses.moving:
            return setup.pressure_pa(poses.pressure_pa)
        rows_s = np.arange(len(poses), dtype=np.float64) * poses.period_s
        count = 1 + (len(poses) - 1) * self.substeps
        steps_s = np.arange(count, dtype=np.float64) * (poses.period_s / self.substeps)
        course, rate = curve(rows_s, poses.pressure_pa, steps_s + setup.sensor_lag_s)
        return setup.pressure_pa(course + setup.sensor_filter_s * rate)

    def slopes(self, setup: Setup, moved: Sequence[Setup], steps: Sequence[float]) -> Array | None:
        """How the tips answer (K, 3, P) to each change of the setup, per unit of its step, by the model's gradients.

        moved: the setup with one change each, so small that the answer is linear in it. None where the model has no
        gradient: in motion with frozen moduli, or under measured wrenches.
        """
        poses, key = self.poses, self._key(setup)
        new = [k for k, other in enumerate(moved) if self._key(other) != key]
        frozen = setup.arm.section_rule not in ("linear", "pointwise")
        if poses.moving and (frozen or poses.wrench.any()):
            return None
        if poses.moving:
            paths = [self._pressure(one) for one in (setup, *(moved[k] for k in new))]
            changes = [Change(steps[k], moved[k].turned_arm, own) for k, own in zip(new, paths[1:], strict=True)]
            weight = np.concatenate([poses.weight_kg[:1], np.repeat(poses.weight_kg[1:], self.substeps)])
            dt_s = poses.period_s / self.substeps
            found = gradient.motion(setup.turned_arm, paths[0], dt_s, changes, weight, self.substeps)
        else:
            changes = [
                Change(steps[k], moved[k].turned_arm, self._pressure(moved[k]), _pull(moved[k], poses)) for k in new
            ]
            rows, pull = self._pressure(setup), _pull(setup, poses)
            found = gradient.statics(setup.turned_arm, rows, changes, poses.weight_kg, pull)
        lever = found.tip_rotation @ np.array(setup.tool_offset_m)
        base = Rotation.from_rotvec(setup.base_rotation_rad).as_matrix()
        out = np.zeros((len(poses), 3, len(moved)))
        out[:, :, new] = base @ (found.tip_by + np.cross(found.turn_by, lever[:, :, None], axis=1))
        point = (found.tip_m + lever) @ base.T
        for k, (other, step) in enumerate(zip(moved, steps, strict=True)):
            shift, turn, tool = (
                (np.array(getattr(other, name)) - np.array(getattr(setup, name))) / step
                for name in ("base_translation_m", "base_rotation_rad", "tool_offset_m")
            )
            turn = _turned_by(np.array(setup.base_rotation_rad)) @ turn
            out[:, :, k] += shift + np.cross(turn, point) + (found.tip_rotation @ tool) @ base.T
        return out

    def pressure_covariance(self, setup: Setup) -> Array:
        """Covariance (K, 3, 3) [m^2] that random pressure errors lend the predictions, by the arm's statics."""
        poses = self.poses
        if not poses.pressure_std_pa.any():
            return np.zeros((len(poses), 3, 3))
        some = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _SENSITIVITIES)).round().astype(int))
        arm, at = setup.turned_arm, setup.pressure_pa(poses.pressure_pa[some])
        changes = [
            Change(gradient.PRESSURE_STEP_PA, arm, at + step)
            for step in gradient.PRESSURE_STEP_PA * np.eye(poses.actuators)
        ]
        slope = np.nan_to_num(gradient.statics(arm, at, changes, poses.weight_kg[some]).tip_by).swapaxes(1, 2)
        nearest = np.abs(np.arange(len(poses))[:, None] - some).argmin(axis=1)
        spread = slope[nearest] * poses.pressure_std_pa[:, :, None]
        out: Array = np.swapaxes(spread, 1, 2) @ spread
        return out


def _turned_by(rotvec: Array) -> Array:
    """How fast a rotation turns (3, 3), in the outer frame, as its rotation vector changes."""
    angle = float(np.linalg.norm(rotvec))
    x, y, z = rotvec
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first, second = (
        (0.5, 1 / 6) if angle < 1e-4 else ((1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3)
    )
    out: Array = np.eye(3) + first * cross + second * cross @ cross
    return out


def _loads(arm: model.Arm, weight_kg: float) -> model.Loads | None:
    if weight_kg == 0:
        return None
    x, y, z = arm.gravity_m_s2
    return model.Loads(tip_force_n=(weight_kg * x, weight_kg * y, weight_kg * z))


def _pull(setup: Setup, poses: Poses) -> Pull | None:
    """The measured wrenches as the arm feels them, at the measured point."""
    if not poses.wrench.any():
        return None
    back = Rotation.from_rotvec(setup.base_rotation_rad).inv()
    return Pull(back.apply(poses.wrench[:, :3]), back.apply(poses.wrench[:, 3:]), np.array(setup.tool_offset_m))


def _resting(setups: Sequence[Setup], pressure_pa: Sequence[Array], poses: Poses, _: int) -> list[Solved]:
    found = [
        gradient.statics(setup.turned_arm, rows, (), poses.weight_kg, _pull(setup, poses))
        for setup, rows in zip(setups, pressure_pa, strict=True)
    ]
    return [(one.tip_m, one.tip_rotation) for one in found]


def _moving(setups: Sequence[Setup], pressure_pa: Sequence[Array], poses: Poses, substeps: int) -> list[Solved]:
    if poses.wrench.any():
        return [_pulled(setup, rows, poses, substeps) for setup, rows in zip(setups, pressure_pa, strict=True)]
    arms = [setup.turned_arm for setup in setups]
    with ThreadPoolExecutor(min(len(arms), os.cpu_count() or 1)) as pool:
        return list(pool.map(_motion, arms, pressure_pa, itertools.repeat(poses), itertools.repeat(substeps)))


def _pulled(setup: Setup, pressure_pa: Array, poses: Poses, substeps: int) -> Solved:
    """In motion under measured wrenches: the lever of the force is that of the step before."""
    arm, pull = setup.turned_arm, _pull(setup, poses)
    assert pull is not None
    count = len(poses)
    tips, turned = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    gravity = np.array(arm.gravity_m_s2)
    dynamics = arm.dynamics(poses.period_s / substeps)
    rotation, begun = np.eye(3), False

    def loads(k: int) -> model.Loads:
        force = pull.force_n[k] + poses.weight_kg[k] * gravity
        lever = np.cross(rotation @ pull.point_m, pull.force_n[k])
        return model.Loads(tip_force_n=force, tip_moment_n_m=pull.moment_n_m[k] + lever)

    for k in range(count):
        if not begun:
            own = Pull(pull.force_n[k : k + 1], pull.moment_n_m[k : k + 1], pull.point_m)
            row = pressure_pa[k * substeps : k * substeps + 1]
            found = gradient.statics(arm, row, (), poses.weight_kg[k : k + 1], own)
            if not found.ok[0]:
                continue
            rotation = found.tip_rotation[0]
            try:
                shape = dynamics.start(pressure_pa[k * substeps], loads(k))
            except model.NotConverged:
                continue
        else:
            for row in pressure_pa[1 + (k - 1) * substeps : 1 + k * substeps]:
                shape = dynamics.step(row, loads(k))
                rotation = shape.tip_rotation
        begun = True
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
    changes = np.flatnonzero(np.diff(weight)) + 1
    for start, stop in itertools.pairwise(sorted({1, *changes.tolist(), len(poses)})):
        rows = pressure_pa[1 + (start - 1) * substeps : 1 + (stop - 1) * substeps]
        # The first step takes up what hangs there; the others go on with it.
        dynamics.step(rows[0], _loads(arm, weight[start]))
        motion = dynamics.run(rows[1:])
        good = motion.ok[substeps - 2 :: substeps]
        tips[start:stop][good] = motion.tip_m[substeps - 2 :: substeps][good]
        turned[start:stop][good] = motion.tip_rotation[substeps - 2 :: substeps][good]
    return tips, turned
