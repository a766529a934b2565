"""Summary of a run: pressure tracking, error between model and measurement, timing.

Definitions. *Error*: distance from the measured to the modelled tool centre point. *Settled*: the mean over the last
`SETTLED_PART` of a dwell, a segment with constant set-points at its end. *Plane of motion*: contains the base
frame's z axis and the direction of motion of the modelled tip; undefined for motion along z only or not in a plane.
*Normalised*: error over the distance of the measured tip from its rest position without pressure and weight.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runs.archive.reader import ArchiveReader
from runs.arrays import Array
from runs.columns import Tip
from runs.columns.conversions import PA_PER_BAR
from runs.periodic_motion import PeriodicMotion, periodic_motions
from runs.records import DetectionStatus, Level, PlayedSegment, Status
from runs.tip_error import TipErrorSummary, tip_error
from runs.tip_plans import TipPlans, tip_plans

SETTLED_PART = 0.3
BAND_BAR = 0.01
"""Settling band: a settled pressure stays this close to its set-point."""
CHI2_3_95 = 7.814727903251179
"""95 % point of chi-squared with three degrees of freedom: the 95 % ellipsoid of a 3-D Gaussian."""
Z_95 = 1.959963984540054
JUMP_BAR = 0.005
"""A larger change of a set-point between cycles is a step."""
_REST_BAR = 0.02
MOVED_MM = 2.0
"""Smallest motion of the tip that defines a plane of motion and a normalised error."""
_FLAT = 0.1

NAN = float("nan")


@dataclass(frozen=True)
class Statistics:
    """Mean, 95th percentile and maximum of an error [mm]; NaN without data."""

    mean: float = NAN
    p95: float = NAN
    max: float = NAN


@dataclass(frozen=True)
class StepSummary:
    """One segment of the protocol, except prompts; NaN for missing measurements."""

    label: str
    kind: str
    start_s: float
    stop_s: float
    level_bar: tuple[float, ...]
    weight_g: float
    """Tip load."""
    dwell: bool
    """The set-points are constant at the end of the segment."""
    settling_s: float
    """Settling time: from the step of a set-point until all pressures stay within `BAND_BAR`; infinite if they do not,
    NaN without a step."""
    overshoot_bar: float
    """Largest overshoot of the actuators with a step, including sensor noise."""
    tracking_rms_bar: float
    """Rms of measured minus set-point over the segment and all actuators."""
    frames: int
    """Frames averaged in the values below: the last part of a dwell, all of any other segment."""
    measured_mm: tuple[float, float, float]
    uncertainty_mm: tuple[float, float, float]
    """Standard uncertainty of one frame, root mean square."""
    model_mm: tuple[float, float, float]
    error_mm: float
    in_plane_mm: float
    normalised_percent: float
    """Of dwells."""

    @property
    def extreme_bar(self) -> float:
        """The set-point at the end that is farthest from zero, pressure or vacuum."""
        return max(self.level_bar, key=abs)


@dataclass(frozen=True)
class TruthSummary:
    """Measured against the simulator's own tip; only for simulated runs."""

    error_mm: Statistics
    in_plane_mm: Statistics
    model_mm: Statistics
    """Model against truth."""
    coverage: float
    """Fraction of measured frames whose truth lies in the stated 95 % ellipsoid."""
    coverage_axes: tuple[float, float, float]
    """The same for each axis and its 95 % interval."""


@dataclass(frozen=True)
class Summary:
    """The whole run."""

    run_id: str
    status: Status
    message: str
    simulated: bool
    duration_s: float
    error_mm: Statistics
    in_plane_mm: Statistics
    rmse_mm: tuple[float, float, float]
    """Root mean square of measured minus model in x, y and z, as in the paper's Table 5."""
    plane_deg: float
    """Azimuth of the plane of motion in the base frame, from x; NaN where there is none."""
    steps: tuple[StepSummary, ...]
    settled_error_mm: float
    """Mean over `settled_steps`."""
    normalised_percent: float
    """The same of the normalised error, as in the paper's Table 3."""
    settling_s: float
    """Longest of the steps."""
    overshoot_bar: float
    """Largest of the steps."""
    tracking_rms_bar: float
    """Over the segments that are not dwells."""
    cycles: int
    missed_deadlines: int
    lateness_p50_us: float
    lateness_p99_us: float
    lateness_max_us: float
    camera: bool
    """A camera or tracker measures the tip; without, every row is a prediction of the model and there are no frames."""
    frames: int
    """Recorded frames, with or without a measured tip."""
    frames_measured: int
    frames_dropped: int
    frames_expected: int
    """Recorded and dropped."""
    ring_overflows: int
    model_failures: int
    reprojection_px: float
    """Median."""
    truth: TruthSummary | None
    tip_path: TipErrorSummary | None = None
    """Error on the paths of the tip; None for a run without one."""
    tip_plans: TipPlans | None = None
    """Plans of the tip controller; None for a run without one."""
    periodic: tuple[PeriodicMotion, ...] = ()
    """The segments whose set-points repeat."""
    frames_oriented: int = 0
    """Measured frames with an orientation of the tip."""
    orientation_std_deg: float = NAN
    """Its standard uncertainty about one axis, root mean square over frames and axes."""

    warnings: tuple[str, ...] = ()
    """Each warning and fault of the run, with its time from the start; one that repeats has its number."""

    @property
    def measured_fraction(self) -> float:
        """Frames with a measured tip over those expected."""
        return self.frames_measured / self.frames_expected if self.frames_expected else NAN


def summarise(run: ArchiveReader) -> Summary:
    """Return the summary of one run."""
    tip, pressure, timing = run.tip, run.pressure, run.timing
    measured = tip.seen == DetectionStatus.MEASURED
    oriented = measured & np.isfinite(tip.orientation_deg).all(axis=1)
    modelled = np.isfinite(tip.model_mm).any()
    plane = plane_of_motion((tip.model_mm if modelled else tip.measured_mm)[measured if measured.any() else ...])
    difference = tip.deviation_mm
    steps = _steps(run, measured, plane)
    moving = [step for step in steps if not step.dwell and np.isfinite(step.tracking_rms_bar)]
    moving_s = np.array([step.stop_s - step.start_s for step in moving])
    late = timing.lateness_us
    return Summary(
        run_id=run.header.run_id,
        status=run.status,
        message=run.message,
        simulated=run.header.simulated,
        duration_s=run.duration_s,
        error_mm=statistics(tip.error_mm[measured]),
        in_plane_mm=statistics(in_plane(difference[measured], plane)),
        rmse_mm=_vector(difference[measured & np.isfinite(difference).all(axis=1)] ** 2, root=True),
        plane_deg=float(np.degrees(np.arctan2(plane[1], plane[0]))) if plane is not None else NAN,
        steps=steps,
        settled_error_mm=_mean([step.error_mm for step in settled_steps(steps)]),
        normalised_percent=_mean([step.normalised_percent for step in settled_steps(steps)]),
        settling_s=max((step.settling_s for step in steps if not np.isnan(step.settling_s)), default=NAN),
        overshoot_bar=max((step.overshoot_bar for step in steps if not np.isnan(step.overshoot_bar)), default=NAN),
        tracking_rms_bar=_weighted_rms(np.array([step.tracking_rms_bar for step in moving]), moving_s),
        cycles=len(pressure.time_s),
        missed_deadlines=int(timing.overruns.sum()),
        lateness_p50_us=_percentile(late, 50),
        lateness_p99_us=_percentile(late, 99),
        lateness_max_us=_percentile(late, 100),
        camera=run.header.measures_tip,
        frames=len(tip.time_s),
        frames_measured=int(measured.sum()),
        frames_dropped=timing.dropped_frames,
        frames_expected=len(tip.time_s) + timing.dropped_frames,
        ring_overflows=timing.ring_overflows,
        model_failures=int((~tip.model_ok).sum()),
        reprojection_px=_percentile(tip.reprojection_px[measured], 50),
        truth=_truth(run, measured, plane),
        tip_path=tip_error(run),
        tip_plans=tip_plans(run),
        periodic=periodic_motions(run),
        frames_oriented=int(oriented.sum()),
        orientation_std_deg=_rms(tip.orientation_uncertainty_deg[oriented].ravel()),
        warnings=tuple(
            f"{(event.t_ns - run.header.started_t_ns) * 1e-9:.1f} s: {event.source}: {event.message.splitlines()[0]}"
            for event in run.events
            if event.level is not Level.INFO and event.message
        ),
    )


def settled_steps(steps: Iterable[StepSummary]) -> tuple[StepSummary, ...]:
    """Return the dwells that have a settled error: those under pressure or weight, or all if there are none."""
    every = tuple(steps)
    loaded = [step.extreme_bar != 0 or step.weight_g > 0 for step in every]
    idle = all(step.dwell for step in every) and not any(loaded)
    return tuple(
        s for s, load in zip(every, loaded, strict=True) if s.dwell and np.isfinite(s.error_mm) and (load or idle)
    )


def plane_of_motion(points_mm: Array) -> Array | None:
    """Return the unit vector (2,) in x and y along which points (n, 3) move; None if they do not span one."""
    points = points_mm[np.isfinite(points_mm).all(axis=1), :2]
    if len(points) < 2:
        return None
    _, size, direction = np.linalg.svd(points, full_matrices=False)
    size = size / np.sqrt(len(points))
    if np.ptp(points @ direction[0]) < MOVED_MM or size[1] > _FLAT * size[0]:
        return None
    unit: Array = direction[0] * (1.0 if direction[0][np.argmax(abs(direction[0]))] > 0 else -1.0)
    return unit


def in_plane(difference_mm: Array, plane: Array | None) -> Array:
    """Return the lengths (n,) of differences (n, 3) projected on the plane of motion; NaN without a plane."""
    if plane is None:
        return np.full(len(difference_mm), NAN)
    return np.asarray(np.hypot(difference_mm[:, :2] @ plane, difference_mm[:, 2]))


def rest_mm(tip: Tip, measured: NDArray[np.bool_]) -> Array:
    """Return the mean measured tip (3,) at rest without pressure and weight; NaN if there is none."""
    rest = measured & (np.abs(tip.pressure_bar) < _REST_BAR).all(axis=1) & ~(tip.weight_g > 0)
    return tip.measured_mm[rest].mean(axis=0) if rest.any() else np.full(3, NAN)


def statistics(errors_mm: Array) -> Statistics:
    """Return mean, 95th percentile and maximum of the finite errors."""
    finite = errors_mm[np.isfinite(errors_mm)]
    if len(finite) == 0:
        return Statistics()
    return Statistics(float(finite.mean()), float(np.percentile(finite, 95)), float(finite.max()))


def _steps(run: ArchiveReader, measured: NDArray[np.bool_], plane: Array | None) -> tuple[StepSummary, ...]:
    rest = rest_mm(run.tip, measured)
    played = (interval for interval in run.header.intervals if interval.kind != "prompt")
    return tuple(_step(run, interval, measured, plane, rest) for interval in played)


def _step(
    run: ArchiveReader, interval: PlayedSegment, measured: NDArray[np.bool_], plane: Array | None, rest: Array
) -> StepSummary:
    tip, pressure = run.tip, run.pressure
    settled_from = interval.stop_s - SETTLED_PART * (interval.stop_s - interval.start_s)
    # Protocol time is monotonic, so a segment is a contiguous range of rows.
    first, last, end = np.searchsorted(pressure.protocol_s, (interval.start_s, settled_from, interval.stop_s))
    setpoint, got = pressure.setpoint_bar[first:end], pressure.measured_bar[first:end]
    dwell = bool(end > last and np.ptp(pressure.setpoint_bar[last:end], axis=0).max() == 0)
    settling, overshoot = NAN, NAN
    before = pressure.setpoint_bar[max(first - 1, 0)] if dwell else None
    if before is not None and (jumped := np.abs(setpoint[-1] - before) > JUMP_BAR).any():
        settling = _settling_s(pressure.time_s[first:end], setpoint, got)
        overshoot = _overshoot_bar(before[jumped], setpoint[-1][jumped], got[:, jumped])
    begin = settled_from if dwell else interval.start_s
    low, high = np.searchsorted(tip.protocol_s, (begin, interval.stop_s))
    frames = low + np.flatnonzero(measured[low:high])
    difference = tip.deviation_mm[frames]
    where = _vector(tip.measured_mm[frames])
    error = _mean(tip.error_mm[frames])
    travelled = float(np.linalg.norm(np.array(where) - rest))
    return StepSummary(
        label=interval.label,
        kind=interval.kind,
        start_s=interval.start_s,
        stop_s=interval.stop_s,
        level_bar=tuple(level / PA_PER_BAR for level in interval.level_pa),
        weight_g=_mean(tip.weight_g[frames]),
        dwell=dwell,
        settling_s=settling,
        overshoot_bar=overshoot,
        tracking_rms_bar=_rms(got - setpoint),
        frames=len(frames),
        measured_mm=where,
        uncertainty_mm=_vector(tip.uncertainty_mm[frames] ** 2, root=True),
        model_mm=_vector(tip.model_mm[frames]),
        error_mm=error,
        in_plane_mm=_mean(in_plane(difference, plane)),
        normalised_percent=100 * error / travelled if dwell and travelled > MOVED_MM else NAN,
    )


def _settling_s(time_s: Array, setpoint: Array, got: Array) -> float:
    """Return the time from the last change of the set-point to the end of the last excursion; infinite if it lasts."""
    still = np.flatnonzero((setpoint != setpoint[-1]).any(axis=1))
    moved = int(still[-1]) + 1 if len(still) else 0
    off: Array = np.abs(got - setpoint)[moved:].max(axis=1)
    outside = np.flatnonzero(off > BAND_BAR)
    if len(outside) == 0:
        return 0.0
    back = moved + int(outside[-1]) + 1
    return float(time_s[back] - time_s[moved]) if back < len(time_s) else np.inf


def _overshoot_bar(before: Array, after: Array, got: Array) -> float:
    """Return the largest overshoot of pressures (n, k) over their new set-points (k,)."""
    beyond = (got - after) * np.sign(after - before)
    return float(max(beyond.max(), 0.0))


def _truth(run: ArchiveReader, measured: NDArray[np.bool_], plane: Array | None) -> TruthSummary | None:
    if run.simulated is None or not measured.any():
        return None
    tip, truth = run.tip, run.simulated.tip_mm
    known = measured & np.isfinite(truth).all(axis=1) & _has_ellipsoid(tip.covariance_mm2)
    if not known.any():
        return None
    difference = tip.measured_mm[known] - truth[known]
    distance2 = np.einsum(
        "ni,ni->n", difference, np.linalg.solve(tip.covariance_mm2[known], difference[..., None])[..., 0]
    )
    within = (np.abs(difference) <= Z_95 * tip.uncertainty_mm[known]).mean(axis=0)
    return TruthSummary(
        error_mm=statistics(np.linalg.norm(difference, axis=1)),
        in_plane_mm=statistics(in_plane(difference, plane)),
        model_mm=statistics(np.linalg.norm(tip.model_mm[known] - truth[known], axis=1)),
        coverage=float((distance2 <= CHI2_3_95).mean()),
        coverage_axes=(float(within[0]), float(within[1]), float(within[2])),
    )


def _has_ellipsoid(covariance: Array) -> NDArray[np.bool_]:
    """Return which covariances (n, 3, 3) are finite and positive definite."""
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    smallest = np.linalg.eigvalsh(np.where(finite[:, None, None], covariance, 0.0))[:, 0]
    largest = np.abs(covariance).max(axis=(1, 2), initial=0.0)
    return np.asarray(finite & (smallest > np.finfo(float).eps * np.where(finite, largest, 0.0)))


def _vector(values: Array, root: bool = False) -> tuple[float, float, float]:
    if len(values) == 0:
        return NAN, NAN, NAN
    x, y, z = np.sqrt(values.mean(axis=0)) if root else values.mean(axis=0)
    return float(x), float(y), float(z)


def _mean(values: Array | list[float]) -> float:
    finite = np.asarray(values)[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else NAN


def _rms(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else NAN


def _weighted_rms(values: Array, weights: Array) -> float:
    return float(np.sqrt(np.average(values**2, weights=weights))) if weights.sum() > 0 else NAN


def _percentile(values: Array, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else NAN
