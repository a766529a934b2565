"""What the identification would read from a run of a protocol: pressures and covariances, tips unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from calibration.identify.data import SETTLE_S
from calibration.identify.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, plan
from protocols import BadInputError, Problem, SetPointTrajectory
from rig.config.schema import RigConfig
from runs.interpolation import interpolated

Array = NDArray[np.float64]

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
        still = plan(name, pressure, weight, errors=errors)
        share = _COMMON + (1 - _COMMON) / np.maximum(counts, 1)
        return replace(still, covariance_m2=still.covariance_m2 * share[:, None, None], frames=counts)
    times = np.arange(frames) / rate_hz
    weight = np.array([trajectory.weight_kg(t) for t in times.tolist()])
    return plan(name, _followed(trajectory, times, config.control.bandwidth_hz), weight, 1 / rate_hz, errors)


def _followed(trajectory: SetPointTrajectory, times_s: Array, bandwidth_hz: float) -> Array:
    """Set-points at times (K,) behind a low-pass filter of first order, (K, N) [Pa]."""
    fine_s = np.arange(0.0, times_s[-1] + 0.005, 0.005)
    keep = np.exp(-2 * np.pi * bandwidth_hz * 0.005)
    smooth = lfilter([1 - keep], [1, -keep], trajectory.sample(fine_s.tolist()), axis=0)
    return interpolated(times_s, fine_s, smooth)
