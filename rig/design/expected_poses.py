"""What the identification would read from a run of a protocol: pressures and covariances, tips unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from calibration.identify.errors import NoDataError
from calibration.identify.observations.data import SETTLE_S, at_rest, in_motion
from calibration.identify.observations.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, plan, scaled_errors
from model.arrays import Array
from protocols import BadInputError, Problem, SetPointTrajectory, arguments
from rig.config.schema import RigConfig
from rig.observation.online_estimation import section_lengths_m
from runs.interpolation import interpolated
from runs.run import Run

# Share of frames in plateaus above which the identification uses plateaus; and the error that their frames share.
_STATIC_SHARE, _COMMON = 0.25, 0.1


def expected_poses(name: str, trajectory: SetPointTrajectory, config: RigConfig, errors: MeasurementErrors) -> Poses:
    """The plateaus of a protocol if they cover a quarter of its frames, else its motion (as `poses_of` of an archive).

    Chambers follow the set-points with the time constant of the rig's regulator.

    Raises:
        BadInputError: the rig has no camera, so that no tip would be measured.
    """
    if not config.measures_tip:
        raise BadInputError(
            [Problem(config.name, 0, 0, "cameras", "none", "a camera: a design is about measured tips")]
        )
    rate_hz = config.observation_hz
    frames = int(trajectory.duration_s * rate_hz)
    plateaus = [s for s in trajectory.segments if s.still and s.stop_s - s.start_s > SETTLE_S]
    counts = np.array([int((s.stop_s - s.start_s - SETTLE_S) * rate_hz) for s in plateaus], np.int64)
    if counts.sum() > _STATIC_SHARE * frames:
        pressure = np.array([s.level_pa for s in plateaus])
        weight = np.array([trajectory.weight_kg(s.stop_s) for s in plateaus])
        still = plan(name, pressure, weight, errors=errors, sections_m=section_lengths_m(config))
        share = _COMMON + (1 - _COMMON) / np.maximum(counts, 1)
        return replace(scaled_errors(still, share), frames=counts, averaged=1 / share)
    times = np.arange(frames) / rate_hz
    weight = np.array([trajectory.weight_kg(t) for t in times.tolist()])
    pressure = _followed(trajectory, times, config.control.bandwidth_hz)
    return plan(name, pressure, weight, 1 / rate_hz, errors, section_lengths_m(config))


def stated_errors(errors: object) -> MeasurementErrors:
    """The errors of measurement that are given, else the default ones; or `BadInputError`."""
    given = MeasurementErrors() if errors is None else errors
    expected = "errors of measurement, as rig.design.expected_poses.errors_of_run(run)"
    return arguments.of_type("errors", given, MeasurementErrors, expected)


def errors_of_run(run: Run) -> MeasurementErrors:
    """The errors of tips, orientations, sections and pressures in a run, as an identification reads them.

    Medians over the run; those of the sections over all of them. Without sections: the default of `MeasurementErrors`.

    Raises:
        NoDataError: the run has no tips with uncertainties, or no pressures.
        BadInputError: it is no run.
    """
    arguments.of_type("--errors-of", run, Run, "an archive, as runs.open(..)")
    motion = in_motion(run)
    seen, tilted = motion.has_tip, motion.has_orientation
    x, y, z = _median_std(motion.covariance_m2[seen]).tolist()
    frame_pa = float(np.median(motion.pressure_std_pa))
    rotation_rad = None
    if motion.orientation is not None and tilted.any():
        rotation_rad = float(_median_std(motion.orientation.covariance_rad2[tilted]).mean())
    found = MeasurementErrors(
        (x, y, z), frame_pa, rotation_rad=rotation_rad, rest_pressure_pa=_plateau_pa(run, frame_pa)
    )
    if not motion.sections:
        return found
    every = _median_std(np.concatenate([one.covariance_m2[one.seen & seen] for one in motion.sections]))
    x, y, z = every.tolist()
    return replace(found, section_m=(x, y, z))


def errors_text(errors: MeasurementErrors, sections: Sequence[str] = ()) -> str:
    """The assumed standard deviations as a text; sections are the names of the measured sections."""
    x, y, z = (1e3 * one for one in errors.tip_m)
    turned = "no orientations"
    if errors.rotation_rad is not None:
        turned = f"orientations {np.rad2deg(errors.rotation_rad):.2g} deg"
    along = "no sections along the arm"
    if sections:
        along = f"sections {', '.join(sections)} {', '.join(f'{1e3 * one:.2g}' for one in errors.section_m)} mm"
    return (
        f"tips {x:.2g}, {y:.2g}, {z:.2g} mm (x, y, z of the rod base), {turned}, {along}, "
        f"pressures {errors.pressure_pa:.2g} Pa in a frame and {errors.plateau_pa:.2g} Pa on a plateau"
    )


def _median_std(covariance: Array) -> Array:
    """Median standard deviation (3,) of covariances (K, 3, 3)."""
    out: Array = np.sqrt(np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    return out


def _plateau_pa(run: Run, frame_pa: float) -> float:
    """Standard deviation of a plateau's mean pressure; of a mean over a second if the run has no plateau."""
    try:
        return float(np.median(at_rest(run).pressure_std_pa))
    except NoDataError:
        return frame_pa / float(np.sqrt(run.header.camera_hz))


def _followed(trajectory: SetPointTrajectory, times_s: Array, bandwidth_hz: float) -> Array:
    """Set-points at times (K,) behind a low-pass filter of first order, (K, N) [Pa]."""
    fine_s = np.arange(0.0, times_s[-1] + 0.005, 0.005)
    keep = np.exp(-2 * np.pi * bandwidth_hz * 0.005)
    smooth = lfilter([1 - keep], [1, -keep], trajectory.sample(fine_s.tolist()), axis=0)
    return interpolated(times_s, fine_s, smooth)
