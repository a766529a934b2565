"""The two shortest controllers, which are also the baselines of the benchmark."""

from __future__ import annotations

from typing import Any

import numpy as np

from model.arrays import Array
from model.inverse.static_map import StaticMap
from rig.tip_control.interface import ControllerMeasurement, ReferenceTrajectory, SetPointPlan, TipControlSettings
from runs.interpolation import interpolated


class StaticInverse:
    """The pressures under which the model's tip at rest is at the reference; no feedback."""

    def __init__(self, settings: TipControlSettings) -> None:
        self._map = StaticMap.of(settings.arm, settings.valve_of, settings.pressure_limit_pa)

    def start(self) -> Any:
        """No memory."""
        return None

    def step(self, state: Any, reference: ReferenceTrajectory, measurement: ControllerMeasurement) -> SetPointPlan:
        """The inverse of each point of the reference."""
        return inverse_plan(self._map, reference, reference.position_m, state)


class InverseIntegral:
    """The static inverse of the reference shifted by the integral of the measured error."""

    GAIN_PER_S = 2.0

    def __init__(self, settings: TipControlSettings) -> None:
        self._map = StaticMap.of(settings.arm, settings.valve_of, settings.pressure_limit_pa)
        self._settings = settings

    def start(self) -> Any:
        """The integral (3,) [m], and the last references (.., 4): time and position."""
        return np.zeros(3), np.empty((0, 4))

    def step(self, state: Any, reference: ReferenceTrajectory, measurement: ControllerMeasurement) -> SetPointPlan:
        """The inverse of the shifted reference; the inverse is the Jacobian's, solved to the end."""
        integral, past = state
        row = np.concatenate([[reference.times_s[0]], reference.position_m[0]])
        past = np.vstack([past[-30:], row])
        wanted = interpolated(measurement.time_s, past[:, 0], past[:, 1:])
        error = wanted - measurement.tip_m
        if past[0, 0] <= measurement.time_s and np.isfinite(measurement.tip_m).all():
            integral = integral + self.GAIN_PER_S * self._settings.frame_s * np.nan_to_num(error)
        return inverse_plan(self._map, reference, reference.position_m + integral, (integral, past))


def inverse_plan(static_map: StaticMap, reference: ReferenceTrajectory, position_m: Array, state: Any) -> SetPointPlan:
    """The plan of the static inverses of positions (H, 3) [m]; beyond the end of the path it is the feed-forward."""
    pressure = static_map.inverse(position_m, reference.feedforward_pa)
    return SetPointPlan(reference.times_s, pressure, np.full(position_m.shape, np.nan), state)
