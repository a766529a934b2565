"""Online estimation of model parameters: an extended Kalman filter over measured tips and sections."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

import model
from calibration.identify.unknowns.memory_parameters import ALL_NAMES
from calibration.identify.unknowns.parameter import Parameter, Prior
from calibration.identify.unknowns.parameters import named
from calibration.identify.unknowns.section_mounts import mount_parameter, offset_names
from calibration.identify.unknowns.setup import Setup
from model.arrays import Array
from model.statics import statics

_STEP = 1e-4
# Standard deviation of a parameter without a prior, in spans.
_PRIOR_SPANS = 0.1
# Parameters without effect on the static model.
_DYNAMIC_ONLY = {"damping_s", "sensor_lag_s", "sensor_filter_s", *ALL_NAMES}
# Innovations of a point beyond this many standard deviations are down-weighted as outliers.
_GATE = 4.0


class NotEstimableError(ValueError):
    """A parameter that is not observable in single frames."""


@dataclass(frozen=True)
class Correction:
    """One frame's result: tip (3,) and sections (S, 3) [m] predicted before the frame was used, and whether it was.

    damped: its tip or a section was an outlier and was down-weighted.
    """

    predicted_m: Array
    sections_m: Array
    used: bool
    damped: bool


@dataclass(frozen=True)
class SectionMeasurements:
    """Measured sections in one frame: points (S, 3) with covariances (S, 3, 3); NaN where a section was not measured.

    motion_m (S, 3): points of the running dynamic model minus its static ones under the same pressures.
    """

    point_m: Array
    covariance_m2: Array
    motion_m: Array


class RecursiveEstimator:
    """Extended Kalman filter over chosen parameters of a setup.

    The measurement model is the static tip under the present pressures plus the dynamic contribution of the running
    model. So a frame costs one equilibrium per parameter, and no dynamic simulation per parameter.

    priors: by name; the default standard deviation is a tenth of a span. floor_m: standard deviation per axis added to
    the covariance of every frame. repeats: number of consecutive frames with the same error, which count as one.
    sections_m: arc lengths [m] of measured sections by name. The offsets of their boards are states of the filter, too,
    with the priors of their parameters; they are not among the `names`.

    Raises:
        UnknownParameter, NotEstimableError: a name in `free` is unknown or not observable.
    """

    def __init__(
        self,
        start: Setup,
        free: Iterable[str],
        priors: Mapping[str, Prior] | None = None,
        floor_m: float = 2e-4,
        repeats: float = 10.0,
        sections_m: Mapping[str, float] | None = None,
    ) -> None:
        actuators = start.arm.geometry.actuators
        self._start = start
        self._sections = dict(sections_m or {})
        self._free: tuple[Parameter, ...] = named(free, actuators)
        self._parameters = (*self._free, *_board_offsets(self._sections, self._free))
        if unobservable := [p.name for p in self._parameters if p.name in _DYNAMIC_ONLY]:
            raise NotEstimableError(
                f"{', '.join(unobservable)}: shows only in how the arm moves; free it in rig identify instead"
            )
        known = {p.name: prior for name, prior in (priors or {}).items() for p in named([name], actuators)}
        first = np.array([p.read(start) for p in self._parameters])
        self._span = np.array([p.span(x) for p, x in zip(self._parameters, first, strict=True)])
        self._first = np.array([known[p.name].mean if p.name in known else x
                                for p, x in zip(self._parameters, first, strict=True)])  # fmt: skip
        stated = [_PRIOR_SPANS * s for s in self._span[: len(self._free)]]
        stated += [p.uncertainty(0.0) for p in self._parameters[len(self._free) :]]
        stds = [(known[p.name].std if p.name in known else std) / s
                  for p, s, std in zip(self._parameters, self._span, stated, strict=True)]  # fmt: skip
        self._z = np.zeros(len(self._parameters))
        self._covariance = np.diag(np.square(stds))
        self._floor, self._repeats = floor_m, repeats
        self._solved: dict[tuple[object, ...], tuple[Array, Array] | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(p.name for p in self._free)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(p.unit for p in self._free)

    @property
    def values(self) -> Array:
        """Estimates (n,)."""
        return (self._first + self._span * self._z)[: len(self._free)]

    @property
    def std(self) -> Array:
        """Their standard deviations (n,)."""
        out: Array = np.sqrt(np.diagonal(self.covariance))
        return out

    @property
    def covariance(self) -> Array:
        """Their covariance (n, n)."""
        n = len(self._free)
        out: Array = self._span[:n, None] * self._covariance[:n, :n] * self._span[:n]
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
        sections: SectionMeasurements | None = None,
    ) -> Correction:
        """Use one frame: measured pressures (N,), tip (3,), its covariance (3, 3), and the measured sections.

        motion_m (3,): tip of the running dynamic model minus its static tip under these pressures. A frame without a
        tip (NaN) or without an equilibrium changes nothing; a section that was not measured is left out.
        """
        self._solved.clear()
        measured, covariance = tip_m[None], covariance_m2[None]
        motion = np.zeros((1, 3)) if motion_m is None else motion_m[None]
        if sections is not None:
            measured = np.concatenate([measured, sections.point_m])
            covariance = np.concatenate([covariance, sections.covariance_m2])
            motion = np.concatenate([motion, sections.motion_m])
        seen: NDArray[np.bool_] = np.asarray(np.isfinite(measured).all(axis=1))
        at = self._points(self._z, pressure_pa, weight_kg)[: len(measured)]
        predicted = at + motion
        used = damped = False
        if seen[0] and np.isfinite(predicted[seen]).all():
            gap = (measured - predicted)[seen].ravel()
            slope = np.stack(
                [
                    (self._points(self._z + step, pressure_pa, weight_kg)[: len(measured)] - at)[seen].ravel() / _STEP
                    for step in _STEP * np.eye(len(self._z))
                ],
                axis=1,
            )
            used = bool(np.isfinite(slope).all())
            if used:
                noise = self._repeats * (covariance[seen] + self._floor**2 * np.eye(3))
                damped = self._update(gap, slope, noise)
        return Correction(predicted[0], predicted[1:], used, damped)

    def _update(self, gap: Array, slope: Array, noise: Array) -> bool:
        """Correct by gaps (3 P,) of P points with the covariances (P, 3, 3); return whether one was an outlier."""
        outlier = False
        noise = noise.copy()
        for k in range(len(noise)):
            own = slice(3 * k, 3 * k + 3)
            innovation = slope[own] @ self._covariance @ slope[own].T + noise[k]
            distance = float(np.sqrt(gap[own] @ np.linalg.solve(innovation, gap[own])))
            if distance > _GATE:
                outlier = True
                noise[k] *= (distance / _GATE) ** 2
        every = block_diag(*noise)
        gain = np.linalg.solve(slope @ self._covariance @ slope.T + every, slope @ self._covariance).T
        self._z = self._bounded(self._z + gain @ gap)
        # Joseph form: stays symmetric and positive definite despite rounding.
        keep = np.eye(len(self._z)) - gain @ slope
        self._covariance = keep @ self._covariance @ keep.T + gain @ every @ gain.T
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

    def _points(self, z: Array, pressure_pa: Array, weight_kg: float) -> Array:
        """Where the static tip and the sections are measured (1 + S, 3) [m]; NaN without an equilibrium."""
        setup = self._setup(z)
        # Base, tool and boards only transform the points of a solved arm.
        key = (setup.turned_arm, setup.sensor_offset_pa, setup.sensor_gain)
        if key not in self._solved:
            self._solved[key] = self._solve(setup, pressure_pa, weight_kg)
        solved = self._solved[key]
        if solved is None:
            return np.full((1 + len(self._sections), 3), np.nan)
        mounts = [setup.tool(), *(setup.mount(name) for name in self._sections)]
        points = zip(*solved, mounts, strict=True)
        return np.concatenate([setup.measured(point[None], rotation[None], mount) for point, rotation, mount in points])

    def _solve(self, setup: Setup, pressure_pa: Array, weight_kg: float) -> tuple[Array, Array] | None:
        """Points (1 + S, 3) and rotations (1 + S, 3, 3) of tip and sections in the rod-base frame."""
        shape = _shape(setup, pressure_pa, weight_kg)
        if shape is None:
            return None
        point, rotation = shape.tip_m[None], shape.tip_rotation[None]
        if not self._sections:
            return point, rotation
        points, rotations = shape.frames_at(np.array(list(self._sections.values())))
        return np.concatenate([point, points]), np.concatenate([rotation, rotations])


def _board_offsets(sections: Iterable[str], free: Iterable[Parameter]) -> tuple[Parameter, ...]:
    """The parameters of the offsets of the sections' boards that are not free."""
    own = {p.name for p in free}
    names = (name for section in sections for name in offset_names(section) if name not in own)
    return tuple(p for name in names if (p := mount_parameter(name)) is not None)


def _shape(setup: Setup, pressure_pa: Array, weight_kg: float) -> model.Shape | None:
    arm = setup.turned_arm
    x, y, z = arm.gravity_m_s2
    loads = model.Loads(tip_force_n=(weight_kg * x, weight_kg * y, weight_kg * z)) if weight_kg else None
    try:
        return statics(arm, setup.pressure_pa(pressure_pa), loads, doubt_units=False)
    except (model.NotConverged, ValueError):
        return None
