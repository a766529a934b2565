"""Simulated experiments with a known truth: what a set of pressures and weights would show of an arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from calibration.identify.fitting.fit import identify
from calibration.identify.fitting.results import Verdict
from calibration.identify.observations.orientation import MIN_FRAMES, Orientations, turned_by
from calibration.identify.observations.poses import Poses
from calibration.identify.observations.pressure_course import PressureCourse
from calibration.identify.observations.pressure_samples import PressureSamples
from calibration.identify.observations.pressure_smoothing import smoothed
from calibration.identify.observations.section_poses import SectionPoses
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.unknowns.memory_parameters import ALL_NAMES, memory_names
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.parameters import known, named
from calibration.identify.unknowns.section_mounts import mount_parameters
from calibration.identify.unknowns.setup import Setup
from calibration.parallel_map import Progress, parallel_map
from model.arrays import Array

LAG_PRIOR = Prior(0.0, 0.005)
# Of the pressures in each frame of a motion.
_SAMPLES = 7
# Time steps per frame of a true motion, extrapolated: finer ones than those of a fit, whose error would not show else.
_TRUE_SUBSTEPS = 8


@dataclass(frozen=True)
class MeasurementErrors:
    """What goes wrong in measuring: standard deviations, per axis of the tip and per sensor.

    pressure_pa: of the mean of the samples within one frame of a motion. rest_pressure_pa: of a plateau's mean; None if
    it is the same. rotation_rad: of the orientation about each axis; None if it is not measured. section_m: of the
    points of measured sections.
    """

    tip_m: tuple[float, float, float] = (2e-4, 4e-4, 2e-4)
    pressure_pa: float = 50.0
    offset_pa: float = 200.0
    rotation_rad: float | None = None
    rest_pressure_pa: float | None = None
    section_m: tuple[float, float, float] = (2e-4, 4e-4, 2e-4)

    @property
    def plateau_pa(self) -> float:
        """Of the mean pressure of a plateau."""
        return self.pressure_pa if self.rest_pressure_pa is None else self.rest_pressure_pa


def plan(
    run_id: str,
    pressure_pa: Array,
    weight_kg: Array | None = None,
    period_s: float = 0.0,
    errors: MeasurementErrors | None = None,
    sections_m: Mapping[str, float] | None = None,
) -> Poses:
    """An experiment that has not been done: pressures (K, N), weights (K,), tips unknown.

    sections_m: arc lengths [m] of measured sections by name.
    """
    errors, k = errors or MeasurementErrors(), len(pressure_pa)
    time_s = np.arange(k, dtype=np.float64) * (period_s or 1.0)
    return Poses(
        run_id=run_id,
        source=f"simulated {run_id}",
        period_s=period_s,
        pressure_pa=pressure_pa,
        pressure_std_pa=np.full(pressure_pa.shape, errors.pressure_pa if period_s else errors.plateau_pa),
        weight_kg=np.zeros(k) if weight_kg is None else weight_kg,
        wrench=np.zeros((k, 6)),
        tip_m=np.full((k, 3), np.nan),
        covariance_m2=np.tile(np.diag(np.square(errors.tip_m)), (k, 1, 1)),
        frames=np.full(k, 1 if period_s else MIN_FRAMES, np.int64),
        time_s=time_s,
        orientation=None if errors.rotation_rad is None else _unmeasured(k, errors.rotation_rad),
        sections=tuple(
            SectionPoses(
                name,
                at_m,
                np.full((k, 3), np.nan),
                np.tile(np.diag(np.square(errors.section_m)), (k, 1, 1)),
                None if errors.rotation_rad is None else _unmeasured(k, errors.rotation_rad),
            )
            for name, at_m in (sections_m or {}).items()
        ),
    )


def scaled_errors(planned: Poses, share: Array) -> Poses:
    """A planned experiment whose covariances of tips, orientations and sections are multiplied by share (K,)."""
    factor = share[:, None, None]

    def scaled(turned: Orientations | None) -> Orientations | None:
        return turned and replace(turned, covariance_rad2=turned.covariance_rad2 * factor)

    return replace(
        planned,
        covariance_m2=planned.covariance_m2 * factor,
        orientation=scaled(planned.orientation),
        sections=tuple(
            replace(one, covariance_m2=one.covariance_m2 * factor, orientation=scaled(one.orientation))
            for one in planned.sections
        ),
    )


def plan_slow(run_id: str, pressure_pa: Array, period_s: float) -> Poses:
    """A slow experiment whose pressures (K, N), period_s apart, are all measured: each pose with the course to it."""
    still = plan(run_id, pressure_pa)
    count = len(pressure_pa)
    course = PressureCourse(period_s, pressure_pa, np.zeros(count), np.zeros((count, 6)), np.arange(count))
    time_s = np.asarray(period_s * np.arange(count), np.float64)
    return replace(still, time_s=time_s, frames=np.ones(count, np.int64), course=course)


def _unmeasured(count: int, std_rad: float) -> Orientations:
    """Orientations that have not been measured."""
    covariance = np.tile(std_rad**2 * np.eye(3), (count, 1, 1))
    return Orientations(np.full((count, 3, 3), np.nan), covariance, np.zeros((count, 3, 3)))


def perform(
    planned: Poses,
    truth: Setup,
    rng: np.random.Generator,
    errors: MeasurementErrors | None = None,
    felt_pa: Array | None = None,
) -> Poses:
    """Do a planned experiment on a simulated arm; its pressures are the true ones, the result's the measured ones.

    felt_pa (K, N): pressures that a static arm responds to, where these are not its own. A motion's true pressures go
    through the planned ones in a smooth curve; measured ones come as late as `truth` says and are smoothed, as those of
    an archive.
    """
    errors = errors or MeasurementErrors()
    plant = replace(truth, sensor_offset_pa=(), sensor_gain=(), sensor_lag_s=0.0)
    offset = rng.normal(0.0, errors.offset_pa, planned.actuators) if errors.offset_pa else np.zeros(planned.actuators)

    def read(pressure_pa: Array, noise_pa: float) -> Array:
        noise = rng.normal(0.0, 1.0, pressure_pa.shape) * noise_pa
        out: Array = pressure_pa * np.array(truth.sensor_gain) + offset + noise
        return out

    samples = None
    if planned.moving:
        curve, end_s = CubicSpline(planned.frame_s, planned.pressure_pa), planned.frame_s[-1]
        steps_s = np.linspace(0.0, end_s, 2 * _TRUE_SUBSTEPS * (len(planned) - 1) + 1)
        true = replace(planned, samples=PressureSamples(steps_s, curve(steps_s)))
        predictor = Predictor(true, _TRUE_SUBSTEPS, extrapolated=True)
        sampled_s = np.linspace(0.0, end_s, _SAMPLES * (len(planned) - 1) + 1)
        noisy = read(curve(sampled_s - truth.sensor_lag_s), errors.pressure_pa * _SAMPLES**0.5)
        samples = PressureSamples(sampled_s, smoothed(noisy)[0])
        measured_pa = samples.pressure_pa[::_SAMPLES]
    else:
        felt = planned if felt_pa is None else replace(planned, pressure_pa=felt_pa)
        predictor = Predictor(felt)
        measured_pa = read(planned.pressure_pa, errors.plateau_pa)
    course = planned.course
    if course is not None:
        through_pa = read(course.pressure_pa, errors.plateau_pa)
        through_pa[course.at] = measured_pa
        course = replace(course, pressure_pa=through_pa)
    tips = predictor(plant)
    done = replace(
        planned,
        pressure_pa=measured_pa,
        course=course,
        samples=samples,
        tip_m=tips + rng.standard_normal((len(planned), 3)) * np.array(errors.tip_m),
    )
    orientation = _turned(planned.orientation, predictor.rotations(plant), rng, errors)
    sections = tuple(
        replace(
            one,
            point_m=point + rng.standard_normal((len(planned), 3)) * np.array(errors.section_m),
            orientation=_turned(one.orientation, rotation, rng, errors),
        )
        for one, (point, rotation) in zip(planned.sections, predictor.sections(plant), strict=True)
    )
    return replace(done, orientation=orientation, sections=sections)


def _turned(
    planned: Orientations | None, rotation: Array, rng: np.random.Generator, errors: MeasurementErrors
) -> Orientations | None:
    """Orientations (K, 3, 3) with errors, where they are measured."""
    if planned is None or errors.rotation_rad is None:
        return planned
    error = rng.normal(0.0, errors.rotation_rad, (len(rotation), 3))
    return turned_by(planned, rotation, error, np.ones(len(rotation), np.bool_))


def perform_as_planned(planned: Poses, truth: Setup, rng: np.random.Generator, errors: MeasurementErrors) -> Poses:
    """As `perform`, but the errors of tips and orientations are drawn from the covariances of the plan, those of the
    pressures from `errors`."""
    nothing = (0.0, 0.0, 0.0)
    without = replace(
        errors, tip_m=nothing, section_m=nothing, rotation_rad=None if planned.orientation is None else 0.0
    )
    exact = perform(planned, truth, rng, without)
    done = replace(exact, tip_m=exact.tip_m + _drawn(planned.covariance_m2, rng))
    if exact.orientation is not None:
        done = replace(done, orientation=_turned_as_planned(exact.orientation, rng))
    sections = tuple(
        replace(
            one,
            point_m=one.point_m + _drawn(one.covariance_m2, rng),
            orientation=None if one.orientation is None else _turned_as_planned(one.orientation, rng),
        )
        for one in exact.sections
    )
    return replace(done, sections=sections)


def _turned_as_planned(exact: Orientations, rng: np.random.Generator) -> Orientations:
    error = _drawn(exact.covariance_rad2, rng)
    return turned_by(exact, exact.rotation, error, np.ones(len(error), np.bool_))


def exact(planned: Poses, truth: Setup) -> Poses:
    """A planned experiment whose tips and orientations are exactly where the model predicts them."""
    predictor = Predictor(planned)
    return located(planned, (predictor(truth), predictor.rotations(truth)), predictor.sections(truth))


def located(planned: Poses, tip: tuple[Array, Array], sections: Sequence[tuple[Array, Array]]) -> Poses:
    """A planned experiment with these points (K, 3) and rotations (K, 3, 3) of the tip and of each section."""

    def turned(orientation: Orientations | None, rotation: Array) -> Orientations | None:
        return orientation and replace(orientation, rotation=rotation)

    return replace(
        planned,
        tip_m=tip[0],
        orientation=turned(planned.orientation, tip[1]),
        sections=tuple(
            replace(one, point_m=point, orientation=turned(one.orientation, rotation))
            for one, (point, rotation) in zip(planned.sections, sections, strict=True)
        ),
    )


def _drawn(covariance: Array, rng: np.random.Generator) -> Array:
    """Normal errors (K, 3) of covariances (K, 3, 3)."""
    out: Array = np.einsum("kij,kj->ki", np.linalg.cholesky(covariance), rng.standard_normal(covariance.shape[:2]))
    return out


@dataclass(frozen=True)
class CoverageTrial:
    """One simulated identification: planned runs, true and starting setup, free parameters, and the seed.

    stated: value and uncertainty of every parameter; the trial then draws each true value from them, `truth` included.
    """

    planned: tuple[Poses, ...]
    truth: Setup
    start: Setup
    free: tuple[str, ...]
    errors: MeasurementErrors
    seed: int
    stated: Mapping[str, Prior] | None = None


@dataclass(frozen=True)
class Coverage:
    """How often the intervals of `names` (n,) held the truth, in how many trials each was identified.

    z (trials, n): errors in units of the stated standard deviation, NaN where not identified.
    """

    names: tuple[str, ...]
    z: Array

    @property
    def share(self) -> Array:
        """Fraction (n,) of trials whose 95 % interval holds the truth."""
        known = np.isfinite(self.z)
        out: Array = ((np.abs(self.z) <= 1.96) & known).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        return out

    @property
    def overall(self) -> float:
        """Over all parameters together."""
        known = np.isfinite(self.z)
        return float((np.abs(self.z[known]) <= 1.96).mean())


def coverage(
    planned: Sequence[Poses],
    truth: Setup,
    start: Setup,
    free: Sequence[str],
    trials: int = 200,
    errors: MeasurementErrors | None = None,
    seed: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
) -> Coverage:
    """Repeat an experiment on a simulated arm and identify it each time; the sensors' zeros are free with a prior."""
    errors = errors or MeasurementErrors()
    task = CoverageTrial(tuple(planned), truth, start, tuple(free), errors, 0)
    tasks = [replace(task, seed=seed * 1_000_003 + k) for k in range(trials)]
    found = np.array(parallel_map(run_trial, tasks, workers, scheduler, store, progress))
    return Coverage(tuple(p.name for p in named(free, planned[0].actuators)), found)


def run_trial(trial: CoverageTrial) -> Array:
    """Errors (n,) of one trial in standard deviations, NaN where a parameter was not identified.

    Free are the sensors' zeros, too, if they err; a sensor's delay is believed to be as `LAG_PRIOR` says.
    """
    rng = np.random.default_rng(trial.seed)
    truth = trial.truth if trial.stated is None else drawn_setup(trial.truth, trial.stated, rng, trial.planned)
    data = [perform(planned, truth, rng, trial.errors) for planned in trial.planned]
    free, priors = list(trial.free), {"sensor_lag_s": LAG_PRIOR}
    if trial.errors.offset_pa:
        free.append("sensor_offsets")
        actuators = data[0].actuators
        priors |= {f"sensor_{n + 1}_offset_pa": Prior(0.0, trial.errors.offset_pa) for n in range(actuators)}
    fit = identify(data, trial.start, free, priors, stated=trial.stated)
    out = []
    for parameter in named(trial.free, data[0].actuators):
        estimate = fit[parameter.name]
        # One that is not distinguished from zero counts, too: without it the others would be a selection.
        counts = estimate.verdict in (Verdict.IDENTIFIED, Verdict.ABSENT)
        out.append((estimate.used - parameter.read(truth)) / estimate.posterior_std if counts else np.nan)
    return np.array(out)


def drawn_setup(
    setup: Setup, stated: Mapping[str, Prior], rng: np.random.Generator, data: Sequence[Poses] = ()
) -> Setup:
    """A setup whose every number is drawn from what is stated of it, within its bounds; without sensor offsets.

    data: the boards of their sections are drawn, too.
    """
    absent = ALL_NAMES - set(memory_names(setup.arm))
    for name, parameter in known(setup.arm.geometry.actuators).items():
        if not parameter.per_run and name not in absent:
            value = rng.normal(stated[name].mean, stated[name].std)
            setup = parameter.write(setup, float(np.clip(value, parameter.lower, parameter.upper)))
    for parameter in mount_parameters(data):
        prior = stated.get(parameter.name, Prior(0.0, parameter.uncertainty(0.0)))
        setup = parameter.write(setup, float(rng.normal(prior.mean, prior.std)))
    return setup
