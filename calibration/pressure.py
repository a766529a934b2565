"""A pressure sensor's scale from readings of a reference gauge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.camera import CalibrationError
from model.arrays import Array

_LEAST_SPAN_V = 0.05


@dataclass(frozen=True)
class SensorFit:
    """Gauge pressure = `offset_pa` + `scale_pa_per_v` times the voltage; `covariance` (2, 2) of both in this order."""

    offset_pa: float
    scale_pa_per_v: float
    covariance: Array
    residuals_pa: Array


def fit_sensor(volts: Array, gauge_pa: Array, gauge_std_pa: float) -> SensorFit:
    """Fit a line through readings (n,); each gauge reading has the standard uncertainty `gauge_std_pa`.

    Residuals larger than that enlarge the covariance.

    Raises:
        CalibrationError: fewer than two different voltages.
    """
    if len(volts) < 2 or np.ptp(volts) < _LEAST_SPAN_V:
        raise CalibrationError("a scale needs readings at two pressures or more, well apart")
    slopes = np.column_stack([np.ones(len(volts)), volts])
    found, *_ = np.linalg.lstsq(slopes, gauge_pa, rcond=None)
    residuals = gauge_pa - slopes @ found
    scatter = float(residuals @ residuals) / max(len(volts) - 2, 1)
    variance = max(gauge_std_pa**2, scatter if len(volts) > 2 else 0.0)
    covariance = variance * np.linalg.inv(slopes.T @ slopes)
    return SensorFit(float(found[0]), float(found[1]), np.asarray(covariance), np.asarray(residuals))
