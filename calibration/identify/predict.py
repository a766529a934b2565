"""Predicted tips: what a setup makes of the pressures and weights of some poses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import model
from calibration.identify.data import Poses
from calibration.identify.parameters import Setup

Array = NDArray[np.float64]

# Time steps per camera period: at one step the time scheme's own damping would pass for the material's.
SUBSTEPS = 2
_KEPT = 64
_SENSITIVITIES = 40
_PRESSURE_STEP_PA = 500.0


@dataclass
class Predictor:
    """Predicts the tips of one `Poses`; keeps the last solved shapes, because mounting and tool need no new ones."""

    poses: Poses
    _solved: dict[tuple[object, ...], tuple[Array, Array]] = field(default_factory=dict)

    def __call__(self, setup: Setup) -> Array:
        """Tips (K, 3) [m] as they would be measured; NaN where the model has no solution."""
        pressure = self.poses.pressure_pa
        if setup.sensor_lag_s and self.poses.moving and len(pressure) > 1:
            pressure = pressure + setup.sensor_lag_s * np.gradient(pressure, self.poses.period_s, axis=0)
        arm = setup.turned_arm
        key = (arm, setup.sensor_offset_pa, setup.sensor_gain, setup.sensor_lag_s)
        if key not in self._solved:
            if len(self._solved) >= _KEPT:
                del self._solved[next(iter(self._solved))]
            true = setup.pressure_pa(pressure)
            self._solved[key] = _moving(arm, true, self.poses) if self.poses.moving else _resting(arm, true, self.poses)
        return setup.measured(*self._solved[key])

    def pressure_covariance(self, setup: Setup) -> Array:
        """Covariance (K, 3, 3) [m^2] that random pressure errors lend the predictions, by the arm's statics."""
        poses = self.poses
        if not poses.pressure_std_pa.any():
            return np.zeros((len(poses), 3, 3))
        some = np.unique(np.linspace(0, len(poses) - 1, min(len(poses), _SENSITIVITIES)).round().astype(int))
        arm = setup.turned_arm
        at = setup.pressure_pa(poses.pressure_pa[some])
        found = np.empty((len(some), 3, 3))
        for k, (pressure, weight) in enumerate(zip(at, poses.weight_kg[some], strict=True)):
            steps = _PRESSURE_STEP_PA * np.eye(poses.actuators)
            loads = _loads(arm, weight)
            high = np.array([_tip(arm, pressure + step, loads)[0] for step in steps])
            low = np.array([_tip(arm, pressure - step, loads)[0] for step in steps])
            slope = (high - low) / (2 * _PRESSURE_STEP_PA) * poses.pressure_std_pa[:, None]
            found[k] = slope.T @ slope
        found = np.where(np.isfinite(found), found, 0.0)
        nearest = np.abs(np.arange(len(poses))[:, None] - some).argmin(axis=1)
        out: Array = found[nearest]
        return out


def _loads(arm: model.Arm, weight_kg: float) -> model.Loads | None:
    if weight_kg == 0:
        return None
    x, y, z = arm.gravity_m_s2
    return model.Loads(tip_force_n=(weight_kg * x, weight_kg * y, weight_kg * z))


def _tip(arm: model.Arm, pressure_pa: Array, loads: model.Loads | None) -> tuple[Array, Array]:
    try:
        shape = arm.statics(pressure_pa, loads)
    except model.NotConverged:
        return np.full(3, np.nan), np.full((3, 3), np.nan)
    return shape.tip_m, shape.tip_rotation


def _resting(arm: model.Arm, pressure_pa: Array, poses: Poses) -> tuple[Array, Array]:
    pairs = [_tip(arm, p, _loads(arm, w)) for p, w in zip(pressure_pa, poses.weight_kg, strict=True)]
    return np.array([tip for tip, _ in pairs]), np.array([rotation for _, rotation in pairs])


def _moving(arm: model.Arm, pressure_pa: Array, poses: Poses) -> tuple[Array, Array]:
    tips, rotations = np.full((len(poses), 3), np.nan), np.full((len(poses), 3, 3), np.nan)
    dynamics = arm.dynamics(poses.period_s / SUBSTEPS)
    loads, hung = _loads(arm, poses.weight_kg[0]), poses.weight_kg[0]
    try:
        shape = dynamics.start(pressure_pa[0], loads)
    except model.NotConverged:
        return tips, rotations
    tips[0], rotations[0] = shape.tip_m, shape.tip_rotation
    for k in range(1, len(poses)):
        if poses.weight_kg[k] != hung:
            loads, hung = _loads(arm, poses.weight_kg[k]), poses.weight_kg[k]
        for part in range(1, SUBSTEPS + 1):
            share = part / SUBSTEPS
            shape = dynamics.step((1 - share) * pressure_pa[k - 1] + share * pressure_pa[k], loads)
        if shape.ok:
            tips[k], rotations[k] = shape.tip_m, shape.tip_rotation
    return tips, rotations
