"""Prediction of held-out runs by a fit, with prediction intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from calibration.identify.fitting.blocks_left_out import left_out_variance
from calibration.identify.fitting.results import NORMAL_95, Fit, SectionFit, rms
from calibration.identify.observations.fit_range import outside, outside_entries
from calibration.identify.observations.poses import Poses
from calibration.identify.prediction.forward_model import ForwardModel
from calibration.identify.unknowns.unknown import Unknown
from model.arrays import Array

# Squared Mahalanobis distance that 95 % of normal tips stay below.
_ELLIPSOID_95 = float(chdtri(3, 0.05))


@dataclass(frozen=True)
class Prediction:
    """Predicted tips (K, 3) of a run, their uncertainty, and what was measured.

    covariance_m2 (K, 3, 3): of measured minus predicted, with the errors of the parameters, of the sensor offsets of
    this run, of the pressures, of the model and of the measured tip. measured_m (K, 3) and before_m (K,), the distance
    [m] by the starting setup, are NaN without a tip.
    """

    run_id: str
    period_s: float
    under_wrench: bool
    """Whether the prediction uses a measured wrench at the tip."""
    time_s: Array
    measured_m: Array
    predicted_m: Array
    covariance_m2: Array
    before_m: Array
    outside: tuple[str, ...]
    """Where the run leaves the range of the fit."""
    sections: tuple[SectionFit, ...] = ()
    """Measured sections of the run and how far they are from their predictions."""

    @property
    def error_m(self) -> Array:
        """Distances (K,) [m] from measured to predicted tips; NaN without a tip."""
        out: Array = np.linalg.norm(self.measured_m - self.predicted_m, axis=1)
        return out

    @property
    def interval_m(self) -> Array:
        """95 % prediction intervals (K, 3, 2) [m] of the measured tips, per axis."""
        half = NORMAL_95 * np.sqrt(np.diagonal(self.covariance_m2, axis1=1, axis2=2))
        return np.stack([self.predicted_m - half, self.predicted_m + half], axis=2)

    @property
    def share_in_95(self) -> Array:
        """Shares (4,) of the tips inside their 95 % intervals along x, y, z, and their 95 % ellipsoids."""
        known = np.isfinite(self.error_m)
        if not known.any():
            return np.full(4, math.nan)
        gap, covariance = (self.measured_m - self.predicted_m)[known], self.covariance_m2[known]
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        distance2 = np.einsum("ki,ki->k", gap, np.linalg.solve(covariance, gap[:, :, None])[:, :, 0])
        inside = np.column_stack([np.abs(gap) <= NORMAL_95 * std, distance2 <= _ELLIPSOID_95])
        out: Array = inside.mean(axis=0)
        return out

    @property
    def std_m(self) -> float:
        """Root mean square of the stated standard deviation of the distance."""
        return float(np.sqrt(np.nanmean(np.trace(self.covariance_m2, axis1=1, axis2=2))))

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


def predict(fit: Fit, poses: Poses) -> Prediction:
    """Predict a run; what is per run, as sensor offsets, is that of its fitted part, else the mean of all runs.

    The intervals are those of the linearised model (delta method). The error of the rod is at least that of blocks that
    are left out of the fit's own data, and where the run leaves the range of the fit that of its highest pressures.
    """
    whole = fit.forward
    seen = next((run for run, other in enumerate(whole.data) if other.source == poses.source), None)
    setup = fit.setup if seen is None else fit.runs[seen].setup
    own = {(one.name, one.run): i for i, one in enumerate(whole.unknowns)}
    unknowns = tuple(dict.fromkeys(replace(one, run=None if one.run is None else 0) for one in whole.unknowns))
    # Each unknown of this run, and where it stands among those of the fit; one of a new run does not.
    at = [own.get((one.name, None if one.run is None else seen)) for one in unknowns]
    forward = ForwardModel([poses], fit.start, unknowns, whole.substeps, whole.extrapolated)
    theta = np.array([one.parameter.read(setup) for one in unknowns])
    slope = forward.slopes(theta)[0][:, :3]
    fitted = [k for k, i in enumerate(at) if i is not None]
    places = [i for i in at if i is not None]
    by_fit = slope[:, :, fitted]
    left_out = left_out_variance(fit)
    unknown_m2 = np.where(outside_entries(whole.data, poses), left_out.out_of_range_m2, left_out.in_range_m2)
    noise_m2 = np.maximum(fit.extra_m**2, unknown_m2)
    covariance = np.nan_to_num(poses.covariance_m2) + forward.pressure_covariances(theta)[0][:, :3, :3]
    covariance = covariance + noise_m2[:, None, None] * np.eye(3)
    covariance += np.einsum("kin,nm,kjm->kij", by_fit, fit.covariance[np.ix_(places, places)], by_fit, optimize=True)
    for k, unknown in enumerate(unknowns):
        if at[k] is None:
            column = slope[:, :, k]
            covariance += _new_run_variance(fit, unknown, float(theta[k])) * column[:, :, None] * column[:, None, :]
    return Prediction(
        run_id=poses.run_id,
        period_s=poses.period_s,
        under_wrench=bool(poses.wrench.any()),
        time_s=poses.time_s,
        measured_m=poses.tip_m,
        predicted_m=forward.predicted(theta)[0],
        covariance_m2=covariance,
        before_m=np.linalg.norm(poses.tip_m - forward.predicted(forward.first)[0], axis=1),
        outside=outside(whole.data, poses),
        sections=SectionFit.every(poses, forward.gaps(theta)[0]),
    )


def _new_run_variance(fit: Fit, unknown: Unknown, value: float) -> float:
    """Mean square error of the value of a new run.

    Such values are drawn from the prior of the unknown. Without a statement they scatter about the mean of the fitted
    runs by the stated uncertainty of their kind: the data tell where they lie.
    """
    if unknown.stated:
        return unknown.std**2 + (value - unknown.mean) ** 2
    stated = fit[unknown.name].stated
    return float(unknown.parameter.uncertainty(value) if stated is None else stated.std) ** 2
