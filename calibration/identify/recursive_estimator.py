"""Online estimation of model parameters: an extended Kalman filter over measured tips."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import model
from calibration.identify.memory_parameters import ALL_NAMES
from calibration.identify.parameter import Parameter, Prior
from calibration.identify.parameters import named
from calibration.identify.setup import Setup
from model.statics import statics

Array = NDArray[np.float64]

_STEP = 1e-4
# Parameters without effect on the static model.
_DYNAMIC_ONLY = {"damping_s", "sensor_lag_s", "sensor_filter_s", *ALL_NAMES}
# Innovations beyond this many standard deviations are down-weighted as outliers.
_GATE = 4.0


class NotEstimableError(ValueError):
    """A parameter that is not observable in single frames."""


@dataclass(frozen=True)
class Correction:
    """One frame's result: the tip predicted before the frame was used (3,) [m], and whether the frame was used.

    damped: it was an outlier and was down-weighted.
    """

    predicted_m: Array
    used: bool
    damped: bool


class RecursiveEstimator:
    """Extended Kalman filter over chosen parameters of a setup.

    The measurement model is the static tip under the present pressures plus the dynamic contribution of the running
    model. So a frame costs one equilibrium per parameter, and no dynamic simulation per parameter.

    priors: by name; the default standard deviation is `doubt` spans. floor_m: standard deviation per axis added to the
    covariance of every frame. repeats: number of consecutive frames with the same error, which count as one.

    Raises:
        UnknownParameter, NotEstimableError: a name in `free` is unknown or not observable.
    """

    def __init__(
        self,
        start: Setup,
        free: Iterable[str],
        priors: Mapping[str, Prior] | None = None,
        doubt: float = 0.1,
        floor_m: float = 2e-4,
        repeats: float = 10.0,
    ) -> None:
        actuators = start.arm.geometry.actuators
        self._start = start
        self._parameters: tuple[Parameter, ...] = named(free, actuators)
        if unobservable := [p.name for p in self._parameters if p.name in _DYNAMIC_ONLY]:
            raise NotEstimableError(
                f"{', '.join(unobservable)}: shows only in how the arm moves; free it in rig identify instead"
            )
        known = {p.name: prior for name, prior in (priors or {}).items() for p in named([name], actuators)}
        first = np.array([p.read(start) for p in self._parameters])
        self._span = np.array([p.span(x) for p, x in zip(self._parameters, first, strict=True)])
        self._first = np.array([known[p.name].mean if p.name in known else x
                                for p, x in zip(self._parameters, first, strict=True)])  # fmt: skip
        doubts = [known[p.name].std / s if p.name in known else doubt
                  for p, s in zip(self._parameters, self._span, strict=True)]  # fmt: skip
        self._z = np.zeros(len(self._parameters))
        self._covariance = np.diag(np.square(doubts))
        self._floor, self._repeats = floor_m, repeats
        self._solved: dict[tuple[object, ...], model.Shape | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(p.name for p in self._parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(p.unit for p in self._parameters)

    @property
    def values(self) -> Array:
        """Estimates (n,)."""
        return self._first + self._span * self._z

    @property
    def std(self) -> Array:
        """Their standard deviations (n,)."""
        out: Array = self._span * np.sqrt(np.diagonal(self._covariance))
        return out

    @property
    def covariance(self) -> Array:
        """Their covariance (n, n)."""
        out: Array = self._span[:, None] * self._covariance * self._span
        return out

    @property
    def setup(self) -> Setup:
        """The setup with the present estimates."""
        return self._setup(self._z)

    def step(
        self,
        pressure_pa: Array,
        tip_m: Array,
        covariance_m2: Array,
        motion_m: Array | None = None,
        weight_kg: float = 0.0,
    ) -> Correction:
        """Use one frame: measured pressures (N,), tip (3,), its covariance (3, 3).

        motion_m (3,): tip of the running dynamic model minus its static tip under these pressures. A frame without a
        tip (NaN) or without an equilibrium changes nothing.
        """
        extra = np.zeros(3) if motion_m is None else motion_m
        self._solved.clear()
        at = self._tip(self._z, pressure_pa, weight_kg)
        predicted = at + extra
        gap = tip_m - predicted
        used = damped = False
        if np.isfinite(gap).all():
            slope = np.stack(
                [
                    (self._tip(self._z + step, pressure_pa, weight_kg) - at) / _STEP
                    for step in _STEP * np.eye(len(self._z))
                ],
                axis=1,
            )
            used = bool(np.isfinite(slope).all())
            if used:
                damped = self._update(gap, slope, self._repeats * (covariance_m2 + self._floor**2 * np.eye(3)))
        return Correction(predicted, used, damped)

    def _update(self, gap: Array, slope: Array, noise: Array) -> bool:
        innovation = slope @ self._covariance @ slope.T + noise
        distance = float(np.sqrt(gap @ np.linalg.solve(innovation, gap)))
        outlier = distance > _GATE
        if outlier:
            noise = noise * (distance / _GATE) ** 2
            innovation = slope @ self._covariance @ slope.T + noise
        gain = np.linalg.solve(innovation, slope @ self._covariance).T
        self._z = self._bounded(self._z + gain @ gap)
        # Joseph form: stays symmetric and positive definite despite rounding.
        keep = np.eye(len(self._z)) - gain @ slope
        self._covariance = keep @ self._covariance @ keep.T + gain @ noise @ gain.T
        return outlier

    def _bounded(self, z: Array) -> Array:
        lower = np.array([p.lower for p in self._parameters])
        upper = np.array([p.upper for p in self._parameters])
        x = np.clip(self._first + self._span * z, lower, upper)
        out: Array = (x - self._first) / self._span
        return out

    def _setup(self, z: Array) -> Setup:
        out = self._start
        for parameter, x in zip(self._parameters, self._first + self._span * self._bounded(z), strict=True):
            out = parameter.write(out, float(x))
        return out

    def _tip(self, z: Array, pressure_pa: Array, weight_kg: float) -> Array:
        setup = self._setup(z)
        # Base and tool only transform the tip of a solved arm.
        key = (setup.arm, setup.actuator_turn_rad, setup.sensor_offset_pa, setup.sensor_gain)
        if key not in self._solved:
            self._solved[key] = _shape(setup, pressure_pa, weight_kg)
        shape = self._solved[key]
        if shape is None:
            return np.full(3, np.nan)
        out: Array = setup.measured(shape.tip_m[None], shape.tip_rotation[None])[0]
        return out


def _shape(setup: Setup, pressure_pa: Array, weight_kg: float) -> model.Shape | None:
    arm = setup.turned_arm
    x, y, z = arm.gravity_m_s2
    loads = model.Loads(tip_force_n=(weight_kg * x, weight_kg * y, weight_kg * z)) if weight_kg else None
    try:
        return statics(arm, setup.pressure_pa(pressure_pa), loads, doubt_units=False)
    except (model.NotConverged, ValueError):
        return None
