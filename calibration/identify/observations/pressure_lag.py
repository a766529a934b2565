"""Pressures behind a first-order lag: tips of a slow motion that follow the measured pressures late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from calibration.identify.observations.poses import Poses
from model.arrays import Array


def lagged_pa(poses: Poses, lag_s: float) -> Array:
    """Pressures (K, N) [Pa] at all entries behind a lag, exact for pressures that change in steps.

    Poses at rest without a course have long been held: theirs do not change.
    """
    if poses.course is not None:
        return _filtered(poses.course.pressure_pa, poses.course.period_s, lag_s)[poses.course.at]
    return _filtered(poses.pressure_pa, poses.period_s, lag_s) if poses.moving else poses.pressure_pa


def behind(poses: Poses, lag_s: float) -> Poses:
    """Frames of a slow motion that are taken as equilibria, under the pressures behind a lag; others are unchanged."""
    if poses.moving or poses.course is None or not lag_s:
        return poses
    course = replace(poses.course, pressure_pa=_filtered(poses.course.pressure_pa, poses.course.period_s, lag_s))
    return replace(poses, course=course, pressure_pa=course.pressure_pa[course.at])


def _filtered(pressure_pa: Array, period_s: float, lag_s: float) -> Array:
    """Pressures (T, N) in even steps behind a lag, from the first pressure on."""
    if lag_s == 0:
        return pressure_pa
    keep = float(np.exp(-period_s / lag_s))
    out: Array = lfilter([1 - keep], [1, -keep], pressure_pa, axis=0, zi=keep * pressure_pa[:1])[0]
    return out
