"""Predicted tips: what a setup makes of the pressures and weights of some poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calibration.identify.observations.poses import Poses
from calibration.identify.observations.pressure_course import PressureCourse
from calibration.identify.observations.pressure_samples import PressureSamples
from calibration.identify.prediction.pose_solutions import (
    Solved,
    dynamic_sensitivities,
    richardson,
    section_places_m,
    solve_dynamic,
    solve_static,
    tip_wrench,
    with_tip,
)
from calibration.identify.prediction.setup_changes import PoseDerivatives, SetupChanges, rotation_between
from calibration.identify.unknowns.setup import Setup
from model import sensitivities
from model.arrays import Array
from model.variation import Variation

Key = tuple[object, ...]

# Time steps per camera period: at one step the time scheme's own damping would pass for the material's.
SUBSTEPS = 2
# Where inertia is asked for: two steps slow the arm's own oscillation, and a density came out 16 % too low. These are
# extrapolated: eight steps alone move a damping by half a percent where the arm is driven near its first mode. There,
# two numbers of steps are not enough for an arm with little damping.
FINE_SUBSTEPS, _FINER = 4, (1.5, 2.0)
_MAX_SOLVED = 64
_MAX_SENSITIVITIES = 40


@dataclass
class Predictor:
    """Predicts the tips of one `Poses`; keeps the last solved shapes, because mounting and tool need no new ones.

    substeps: time steps per frame of a motion. extrapolated: its tips with this many steps, an even number, with 1.5
    times and with twice as many are extrapolated to infinitely many (Richardson). Its slopes are those of the coarse
    steps: the search needs no better ones, and they are most of its cost.
    """

    poses: Poses
    substeps: int = SUBSTEPS
    extrapolated: bool = False
    _solved: dict[Key, Solved] = field(default_factory=dict)
    _finer: tuple[Predictor, ...] = ()
    _through: Predictor | None = None

    def __call__(self, setup: Setup) -> Array:
        """Tips (K, 3) [m] as they would be measured; NaN where the model has no solution."""
        points, rotations = self._shapes(setup)
        return setup.measured(points[:, 0], rotations[:, 0])

    def rotations(self, setup: Setup) -> Array:
        """Orientations (K, 3, 3) as they would be measured; NaN where the model has no solution."""
        return setup.oriented(self._shapes(setup)[1][:, 0])

    def sections(self, setup: Setup) -> tuple[tuple[Array, Array], ...]:
        """Points (K, 3) and orientations (K, 3, 3) of each section of the poses as they would be measured."""
        points, rotations = self._shapes(setup)
        mounts = [setup.mount(one.name) for one in self.poses.sections]
        return tuple(
            (setup.measured(points[:, k], rotations[:, k], mount), setup.oriented(rotations[:, k], mount))
            for k, mount in enumerate(mounts, start=1)
        )

    def gap(self, setup: Setup) -> Array:
        """Measured minus predicted (K, D) [m, rad]: points, and the rotation vectors between orientations.

        NaN where there is no measurement or no solution.
        """
        poses = self.poses
        measured = [(poses.tip_m, poses.orientation), *((one.point_m, one.orientation) for one in poses.sections)]
        predicted = [(self(setup), self.rotations(setup)), *self.sections(setup)]
        out = []
        for (point, orientation), (own, rotation) in zip(measured, predicted, strict=True):
            out.append(point - own)
            if orientation is not None:
                out.append(rotation_between(orientation.rotation, rotation))
        return np.concatenate(out, axis=1)

    def _shapes(self, setup: Setup) -> Solved:
        if (course := self._course(setup)) is not None:
            tips, rotations = self._along(course)._shapes(_without_inertia(setup))
            return tips[course.at], rotations[course.at]
        coarse = self._solved_with_substeps(setup)
        if not (self.extrapolated and self.poses.moving):
            return coarse
        if not self._finer:
            self._finer = tuple(Predictor(self.poses, round(finer * self.substeps)) for finer in _FINER)
        every = (coarse, *(one._solved_with_substeps(setup) for one in self._finer))
        return richardson(every, (self.substeps, *(one.substeps for one in self._finer)))

    def _solved_with_substeps(self, setup: Setup) -> Solved:
        """The shapes with the time steps of this predictor; kept."""
        key = self._key(setup)
        found = self._solved.get(key)
        if found is None:
            solve = solve_dynamic if self.poses.moving else solve_static
            found = solve(setup, self._pressure(setup), self.poses, self.substeps)
            self._keep(key, found)
        return found

    def _keep(self, key: Key, found: Solved) -> None:
        """Keep the solved shapes of a setup."""
        if key not in self._solved:
            self._solved = dict([*self._solved.items(), (key, found)][-_MAX_SOLVED:])

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
        count = 1 + (len(poses) - 1) * self.substeps
        steps_s = np.arange(count, dtype=np.float64) * (poses.period_s / self.substeps)
        samples = poses.samples or PressureSamples(poses.frame_s, poses.pressure_pa)
        course, rate = samples.at(steps_s + setup.sensor_lag_s)
        return setup.pressure_pa(course + setup.sensor_filter_s * rate)

    def slopes(self, setup: Setup, perturbed: Sequence[Setup], steps: Sequence[float]) -> Array:
        """Derivatives (K, D, P) of predictions by each change of the setup, per unit of its step.

        perturbed: the setup with one change each, so small that predictions are linear in it.
        """
        if (course := self._course(setup)) is not None:
            along = self._along(course).slopes(_without_inertia(setup), [_without_inertia(p) for p in perturbed], steps)
            return along[course.at]
        key = self._key(setup)
        new = [k for k, other in enumerate(perturbed) if self._key(other) != key]
        repeats = self.substeps if self.poses.moving else 1
        changes = [
            Variation(
                steps[k],
                perturbed[k].turned_arm,
                self._pressure(perturbed[k]),
                tip_wrench(perturbed[k], self.poses, repeats),
            )
            for k in new
        ]
        return self._slopes(changes, SetupChanges(setup, perturbed, steps, new))

    def _slopes(self, changes: Sequence[Variation], changed: SetupChanges) -> Array:
        """Derivatives (K, D, P) of predictions by changes of a setup, of which `changes` are those of its arm."""
        poses, setup = self.poses, changed.setup
        rows, wrench = self._pressure(setup), tip_wrench(setup, poses, self.substeps if poses.moving else 1)
        if poses.moving:
            found = dynamic_sensitivities(setup, rows, changes, poses, self.substeps, wrench)
        else:
            found = sensitivities.statics(
                setup.turned_arm, rows, changes, poses.weight_kg, wrench, sections_m=section_places_m(poses)
            )
        self._keep(self._key(setup), with_tip(found))
        tip = PoseDerivatives(found.tip_m, found.tip_rotation, found.tip_by, found.turn_by)
        parts = [changed.slopes(tip, poses.orientation, Setup.tool)]
        for k, one in enumerate(poses.sections):
            section = PoseDerivatives(
                found.section_m[:, k], found.section_rotation[:, k], found.section_by[:, k], found.section_turn_by[:, k]
            )
            parts.append(changed.slopes(section, one.orientation, partial(Setup.mount, section=one.name)))
        return np.concatenate(parts, axis=1)

    def _course(self, setup: Setup) -> PressureCourse | None:
        """The course that leads to the poses, where the arm remembers it."""
        return self.poses.course if setup.arm.remembers and not self.poses.moving else None

    def _along(self, course: PressureCourse) -> Predictor:
        """The predictor of all rows of the course."""
        if self._through is None:
            self._through = Predictor(_as_motion(self.poses, course), 1)
        return self._through

    def pressure_covariance(self, setup: Setup) -> Array:
        """Covariances (K, D, D) of the predictions by the errors of the measured pressures, as of an arm at rest."""
        poses = self.poses
        if not poses.pressure_std_pa.any():
            return np.zeros((len(poses), poses.numbers, poses.numbers))
        still, nearest = self._at_rest()
        spread = _by_pressure(still, setup)[nearest] * poses.pressure_std_pa[:, None, :]
        out: Array = spread @ np.swapaxes(spread, 1, 2)
        return out

    def _at_rest(self) -> tuple[Predictor, NDArray[np.intp]]:
        """A predictor of some poses as equilibria, and the number (K,) of the nearest of them for each pose."""
        count = len(self.poses)
        some = np.unique(np.linspace(0, count - 1, min(count, _MAX_SENSITIVITIES)).round().astype(int))
        nearest = np.abs(np.arange(count)[:, None] - some).argmin(axis=1)
        return Predictor(replace(self.poses.only(some), period_s=0.0, course=None, samples=None)), nearest


def _without_inertia(setup: Setup) -> Setup:
    """The setup of slow poses: no inertia, and sensors that keep up."""
    return replace(setup, arm=replace(setup.arm, inertia=False), sensor_lag_s=0.0, sensor_filter_s=0.0)


def _as_motion(poses: Poses, course: PressureCourse) -> Poses:
    """The rows of a course as a motion without measured tips."""
    count = len(course.pressure_pa)
    return replace(
        poses,
        period_s=course.period_s,
        pressure_pa=course.pressure_pa,
        pressure_std_pa=np.zeros_like(course.pressure_pa),
        weight_kg=course.weight_kg,
        wrench=course.wrench,
        tip_m=np.full((count, 3), np.nan),
        covariance_m2=np.full((count, 3, 3), np.nan),
        frames=np.ones(count, np.int64),
        time_s=np.asarray(np.arange(count) * course.period_s, np.float64),
        live_m=None,
        course=None,
        samples=None,
        orientation=None if poses.orientation is None else poses.orientation.spread(course.at, count),
        sections=tuple(one.spread(course.at, count) for one in poses.sections),
    )


def _by_pressure(still: Predictor, setup: Setup) -> Array:
    """Derivatives (K, D, N) of predictions at rest by the offsets of the sensors."""
    step = sensitivities.PRESSURE_STEP_PA
    zeros = setup.sensor_offset_pa + step * np.eye(still.poses.actuators)
    perturbed = [replace(setup, sensor_offset_pa=tuple(own)) for own in zeros.tolist()]
    out: Array = np.nan_to_num(still.slopes(setup, perturbed, [step] * len(perturbed)))
    return out
