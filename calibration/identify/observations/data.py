"""Poses of an archive: its static plateaus or its motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from calibration.identify.errors import NoDataError
from calibration.identify.observations.orientation import MIN_FRAMES, averaged_share, mean_orientations, orientations
from calibration.identify.observations.poses import Poses
from calibration.identify.observations.pressure_course import PressureCourse, course_rows, mean_around
from calibration.identify.observations.pressure_samples import on_even_frames
from calibration.identify.observations.pressure_smoothing import curve, noise_std, regression_calibrated, smoothed
from calibration.identify.observations.section_poses import mean_sections, section_poses
from model.arrays import Array
from model.units import KG_PER_G, M_PER_MM, PA_PER_BAR
from runs.interpolation import interpolated
from runs.records import DetectionStatus
from runs.run import Run

SETTLE_S = 1.5
# A frame is used if it lies at most this many camera periods outside the pressure record.
_PRESSURE_MARGIN_FRAMES = 1.5
# Samples around a clipped one that count as clipped.
_CLIP_WINDOW = 21
# Some scans are clipped if the mean lies less than so many standard deviations of a scan above the foot.
_CLIP_STD = 1.0
# A sensor that is clipped in a larger share of a motion has a constant error there, which its offset describes.
_MOSTLY = 0.9


def at_rest(run: Run, settle_s: float = SETTLE_S) -> Poses:
    """The plateaus of a run: set-points and weight are constant, and have been for `settle_s`.

    Each plateau becomes one entry: mean pressure and mean tip. Its frames have a common error that does not average
    out. Its variance is the stated variance minus the scatter within the plateaus, and at least a tenth of
    the stated one.

    Raises:
        NoDataError: the run has no plateau that is long enough.
    """
    tip, setpoint = run.tip, run.pressure.setpoint_bar
    still = _unchanged(run.pressure.time_s, setpoint, tip.time_s)
    same = np.concatenate([[False], np.diff(tip.weight_g) == 0])
    # While the run waits for the operator, protocol time is constant and the weight is unknown.
    going = np.concatenate([[False], np.diff(tip.protocol_s) > 0])
    held = still & same & going
    usable = _usable(run)
    plateaus = []
    for start, stop in _true_ranges(held):
        inside = np.arange(start, stop)
        inside = inside[(tip.time_s[inside] >= tip.time_s[start] + settle_s) & usable[inside]]
        if len(inside) >= MIN_FRAMES:
            plateaus.append(inside)
    if not plateaus:
        raise NoDataError(f"{run.header.run_id}: no plateau longer than {settle_s:g} s with a measured tip")
    covariance = np.array([tip.covariance_mm2[k].mean(axis=0) for k in plateaus]) * M_PER_MM**2
    count = np.array([len(k) for k in plateaus])
    middle = np.array([tip.measured_mm[k].mean(axis=0) for k in plateaus]) * M_PER_MM
    scatter = [tip.measured_mm[k] * M_PER_MM - at for k, at in zip(plateaus, middle, strict=True)]
    averaged = averaged_share(scatter, covariance)
    samples = _pressure_samples(run)
    spans = [np.searchsorted(samples.time_s, [tip.time_s[k[0]], tip.time_s[k[-1]]]) for k in plateaus]
    parts = [slice(first, max(last, first + 1)) for first, last in spans]
    pressure = [samples.pa[part] for part in parts]
    middle_s, means = np.array([tip.time_s[k].mean() for k in plateaus]), np.array([p.mean(axis=0) for p in pressure])
    noise = np.sqrt(np.mean([part.var(axis=0) / max(len(part) - 1, 1) for part in pressure], axis=0))
    clipped = np.array([samples.clipped[part].any(axis=0) for part in parts])
    return Poses(
        run_id=run.header.run_id,
        source=run.sha256,
        period_s=0.0,
        pressure_pa=means,
        pressure_std_pa=np.where(clipped, np.hypot(noise, samples.clipped_std_pa), noise),
        weight_kg=np.array([tip.weight_g[k].mean() for k in plateaus]) * KG_PER_G,
        wrench=np.array([_wrench(run)[k].mean(axis=0) for k in plateaus]),
        tip_m=middle,
        covariance_m2=covariance * averaged[:, None, None],
        frames=count,
        time_s=np.array([tip.time_s[k[-1]] for k in plateaus]),
        live_m=_live(np.array([_model_mm(run)[k].mean(axis=0) for k in plateaus])),
        course=_course(run, samples, middle_s, means),
        orientation=mean_orientations(run, plateaus, averaged),
        sections=mean_sections(run, plateaus),
        averaged=1 / averaged,
    )


def _course(run: Run, samples: _Samples, pose_s: Array, pressure_pa: Array) -> PressureCourse:
    """The course of a run up to its last pose; at the poses (K,) it has their pressures (K, N)."""
    tip, loaded = run.tip, _load_is_known(run)
    time_s, at = course_rows(float(samples.time_s[0]), pose_s)
    pressure = mean_around(time_s, samples.time_s, samples.pa)
    pressure[at] = pressure_pa
    weight = tip.weight_g[np.clip(np.searchsorted(tip.time_s, time_s, side="right") - 1, 0, None)] * KG_PER_G
    wrench = interpolated(time_s, tip.time_s[loaded], _wrench(run)[loaded])
    return PressureCourse(float(time_s[1] - time_s[0]), pressure, weight, wrench, at)


def in_motion(run: Run) -> Poses:
    """Every frame of a run, one camera period apart, from the first frame to the last that shows the tip.

    Raises:
        NoDataError: no frame shows the tip.
    """
    tip = run.tip
    usable = _usable(run)
    if not usable.any():
        raise NoDataError(f"{run.header.run_id}: no frame shows the tip while pressures were recorded")
    loaded = _load_is_known(run)
    index = tip.frame - tip.frame[0]
    length = int(index[usable][-1]) + 1
    # Cameras do not always deliver the requested rate.
    period_s = float(tip.time_s[-1] - tip.time_s[0]) / index[-1] if index[-1] else 1.0 / run.header.camera_hz
    if period_s <= 0.0:
        raise NoDataError(f"{run.header.run_id}: entry/tip/time does not increase from the first frame to the last")
    every = np.arange(length)
    samples = _pressure_samples(run)
    course, deviation = smoothed(samples.pa)
    # Smoothed values correlate, but the fit treats frames as independent: so the deviation of a frame is at least that
    # of the mean of its own samples.
    step_s = float(np.median(np.diff(samples.time_s))) if len(samples.time_s) > 1 else period_s
    deviation = np.maximum(deviation, noise_std(samples.pa) * min(1.0, np.sqrt(step_s / period_s)))
    # A sensor at its foot shows no noise; it resolves no more than the others.
    deviation[:, samples.clipped.mean(axis=0) > _MOSTLY] = deviation.max(axis=1, keepdims=True)
    course = regression_calibrated(course, deviation)
    frame_s = np.interp(every, index, tip.time_s)
    pressure = curve(samples.time_s, course, frame_s)[0]
    spread = interpolated(frame_s, samples.time_s, deviation)
    near_limit = maximum_filter1d(samples.clipped.astype(float), _CLIP_WINDOW, axis=0)
    clipped = interpolated(frame_s, samples.time_s, near_limit) > 0
    weight = tip.weight_g[np.clip(np.searchsorted(index, every, side="right") - 1, 0, None)] * KG_PER_G
    measured, covariance = np.full((length, 3), np.nan), np.full((length, 3, 3), np.nan)
    measured[index[usable]] = tip.measured_mm[usable] * M_PER_MM
    live = np.full((length, 3), np.nan)
    live[index[usable]] = _model_mm(run)[usable]
    covariance[index[usable]] = tip.covariance_mm2[usable] * M_PER_MM**2
    at = np.full(length, -1)
    at[index[usable]] = np.flatnonzero(usable)
    return Poses(
        run_id=run.header.run_id,
        source=run.sha256,
        period_s=period_s,
        pressure_pa=pressure,
        pressure_std_pa=np.where(clipped, np.hypot(spread, samples.clipped_std_pa * _repeats(clipped)), spread),
        weight_kg=weight,
        wrench=interpolated(frame_s, tip.time_s[loaded], _wrench(run)[loaded]),
        tip_m=measured,
        covariance_m2=covariance,
        frames=np.ones(length, np.int64),
        time_s=frame_s,
        live_m=_live(live),
        orientation=orientations(run, at),
        sections=section_poses(run, at),
        samples=on_even_frames(samples.time_s, course, frame_s, period_s),
    )


def quasi_static_poses(run: Run) -> Poses:
    """Every frame of a slow motion that shows the tip, each as a static equilibrium.

    Raises:
        NoDataError: no frame shows the tip.
    """
    motion = in_motion(run)
    every = np.arange(len(motion))
    course = PressureCourse(motion.period_s, motion.pressure_pa, motion.weight_kg, motion.wrench, every)
    return replace(motion, period_s=0.0, course=course, samples=None).only(motion.has_tip)


def poses_of(run: Run) -> Poses:
    """The plateaus of a run if they cover a quarter of its frames, else its motion."""
    try:
        rest = at_rest(run)
    except NoDataError:
        return in_motion(run)
    return rest if rest.frames.sum() > 0.25 * len(run.tip.time_s) else in_motion(run)


def _usable(run: Run) -> NDArray[np.bool_]:
    """Frames (M,) with a measured tip. `NoDataError` if pressures or uncertainties are missing (imported archives)."""
    tip = run.tip
    usable: NDArray[np.bool_] = (tip.seen == DetectionStatus.MEASURED) & np.isfinite(tip.measured_mm).all(axis=1)
    if not len(run.pressure.time_s):
        raise NoDataError(f"{run.header.run_id}: no pressure was recorded")
    # Frames after the end of control have no pressures.
    first_s, last_s = (
        run.pressure.time_s[[0, -1]] + np.array([-1.0, 1.0]) * _PRESSURE_MARGIN_FRAMES / run.header.camera_hz
    )
    usable &= (tip.time_s >= first_s) & (tip.time_s <= last_s)
    loaded = _load_is_known(run)
    known = np.flatnonzero(loaded)
    if len(loaded) and not (len(known) and loaded[known[0] : known[-1] + 1].all()):
        raise NoDataError(f"{run.header.run_id}: the measured tip force is missing in some frames")
    usable &= loaded
    covariance = tip.covariance_mm2[usable]
    if not np.isfinite(covariance).all():
        raise NoDataError(
            f"{run.header.run_id}: the tips come without an uncertainty; state one (import: uncertainty_mm)"
        )
    if (np.linalg.eigvalsh(covariance)[:, 0] <= 0).any():
        raise NoDataError(
            f"{run.header.run_id}: the tips' uncertainty is zero along an axis: no measurement is that good"
        )
    if not np.isfinite(run.pressure.measured_bar).all():
        raise NoDataError(f"{run.header.run_id}: pressures are missing in some rows")
    return usable


@dataclass(frozen=True)
class _Samples:
    """Pressures (n, N) [Pa] at times (n,) [s].

    clipped (n, N): the reading is at the lower end of the sensor's range, at least in some of its scans.
    clipped_std_pa (N,) is the standard deviation of the pressure then.
    """

    time_s: Array
    pa: Array
    clipped: NDArray[np.bool_]
    clipped_std_pa: Array


def _pressure_samples(run: Run) -> _Samples:
    """The measured pressures, with time stamps at the middle of the scans that each sample is the mean of."""
    samples = run.pressure
    scans = np.maximum(samples.scans, 1)
    late_s = (scans - 1) / (2 * scans * run.header.control_hz)
    foot, offset_std = np.full(run.header.actuators, -np.inf), np.zeros(run.header.actuators)
    for quantity in run.header.quantities:
        for n in range(run.header.actuators):
            if quantity.name == f"sensor_{n + 1}_offset" and np.isfinite(quantity.uncertainty):
                foot[n] = quantity.value[0]
                # Uniform distribution over the sensor's accuracy.
                offset_std[n] = quantity.uncertainty * PA_PER_BAR / np.sqrt(12)
    scan_bar = noise_std(samples.measured_bar).max() * np.sqrt(np.median(scans))
    at_foot = samples.measured_bar <= foot + 1e-9
    at_foot |= uniform_filter1d(samples.measured_bar, _CLIP_WINDOW, axis=0) <= foot + _CLIP_STD * scan_bar
    return _Samples(samples.time_s - late_s, samples.measured_bar * PA_PER_BAR, at_foot, offset_std)


def _repeats(clipped: NDArray[np.bool_]) -> Array:
    """Factor (K, N) on the error of clipped frames (K, N), for all of one range have the same error."""
    out = np.ones(clipped.shape)
    for n, column in enumerate(clipped.T):
        if column.mean() <= _MOSTLY:
            for start, stop in _true_ranges(column):
                out[start:stop, n] = np.sqrt(stop - start)
    return out


def _model_mm(run: Run) -> Array:
    """Tips (M, 3) of the running model; NaN where it had no solution."""
    return np.where(run.tip.model_ok[:, None], run.tip.model_mm, np.nan)


def _live(model_mm: Array) -> Array | None:
    """Tips of the running model [m]; None if it has none, as in an import."""
    return model_mm * M_PER_MM if np.isfinite(model_mm).any() else None


def _wrench(run: Run) -> Array:
    """Force and moment (M, 6) at the measured point."""
    return np.concatenate([run.tip.force_n, run.tip.moment_n_m], axis=1)


def _load_is_known(run: Run) -> NDArray[np.bool_]:
    """Frames (M,) with a force and moment; one that is measured is NaN before its first sample."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(_wrench(run)).all(axis=1))
    return known


def _unchanged(time_s: Array, setpoint: Array, frame_s: Array) -> NDArray[np.bool_]:
    """For each frame, whether the set-points have not changed since the frame before; False for NaN (imported runs)."""
    moved = np.concatenate([[0], np.cumsum(~(np.abs(np.diff(setpoint, axis=0)) <= 1e-9).all(axis=1))])
    then = moved[np.clip(np.searchsorted(time_s, frame_s, side="right") - 1, 0, len(moved) - 1)]
    return np.concatenate([[False], np.diff(then) == 0])


def _true_ranges(true: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Start and stop of every contiguous range of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], true.astype(np.int8), [0]])))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
