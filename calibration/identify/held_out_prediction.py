"""Prediction of held-out runs by a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.identify.data import Poses
from calibration.identify.parameters import Setup, known
from calibration.identify.results import Fit, rms
from calibration.identify.tip_predictor import Predictor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Distances (K,) [m] from measured to predicted tips, by the starting setup and by the fit; NaN without a tip."""

    run_id: str
    period_s: float
    under_wrench: bool
    """Whether the prediction uses a measured wrench at the tip."""
    predicted_m: Array
    before_m: Array
    error_m: Array

    @property
    def unsolved(self) -> int:
        """Entries for which the model has no solution."""
        return int((~np.isfinite(self.predicted_m).all(axis=1)).sum())

    @property
    def rms_m(self) -> float:
        """Root mean square distance by the fit."""
        return rms(self.error_m)

    @property
    def mean_m(self) -> float:
        """Mean distance by the fit."""
        found = self.error_m[np.isfinite(self.error_m)]
        return float(found.mean()) if len(found) else math.nan

    @property
    def p95_m(self) -> float:
        """95th percentile of the distances by the fit."""
        found = self.error_m[np.isfinite(self.error_m)]
        return float(np.percentile(found, 95)) if len(found) else math.nan

    @property
    def rms_before_m(self) -> float:
        """Root mean square distance by the setup that the fit started from."""
        return rms(self.before_m)


def with_mean_sensor_offsets(fit: Fit) -> Setup:
    """The fitted setup with each sensor offset at its mean over the runs in which it is identified."""
    setup = fit.setup
    for name, parameter in known(setup.arm.geometry.actuators).items():
        values = [e.value for e in fit.estimates if e.name == name and e.run and e.value is not None]
        if values:
            setup = parameter.write(setup, float(np.mean(values)))
    return setup


def predict(fit: Fit, poses: Poses) -> Prediction:
    """Predict a run; its sensor offsets are the means of those of the fitted runs."""
    predictor = Predictor(poses, fit.problem.substeps)
    tips, before = predictor(with_mean_sensor_offsets(fit)), predictor(fit.start)
    return Prediction(
        run_id=poses.run_id,
        period_s=poses.period_s,
        under_wrench=bool(poses.wrench.any()),
        predicted_m=tips,
        before_m=np.linalg.norm(poses.tip_m - before, axis=1),
        error_m=np.linalg.norm(poses.tip_m - tips, axis=1),
    )
