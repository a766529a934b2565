"""The table of methods: the rod beside the baselines, on the same tips."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from calibration.baselines.repeatability import Repeatability
from calibration.baselines.selection import BaselineFit
from calibration.identify.observations.poses import Poses
from model.arrays import Array

ROD = "rod"
# Squared Mahalanobis distance that 95 % of normal tips stay below.
_ELLIPSOID_95 = float(chdtri(3, 0.05))
# A method is better or worse where the errors differ by more than this share: less is chance of the data.
_DIFFERENT = 0.05


@dataclass(frozen=True)
class MethodErrors:
    """Errors of a method on one set of tips: rms and largest distance [m], and the share inside the stated ellipsoids.

    share_in_95 is NaN for a method that states nothing of these tips.
    """

    method: str
    rms_m: float
    largest_m: float
    share_in_95: float

    @classmethod
    def of(cls, method: str, error_m: Array, covariance_m2: Array | None) -> MethodErrors:
        """From errors (K, 3) [m] and their stated covariances (K, 3, 3), or one for all of them (3, 3)."""
        known = np.isfinite(error_m).all(axis=1)
        error = error_m[known]
        if not len(error):
            return cls(method, math.nan, math.nan, math.nan)
        distance, share = np.linalg.norm(error, axis=1), math.nan
        if covariance_m2 is not None:
            stated = np.broadcast_to(covariance_m2, (len(error_m), 3, 3))[known] + 1e-18 * np.eye(3)
            squared = np.einsum("ki,ki->k", error, np.linalg.solve(stated, error[:, :, None])[:, :, 0])
            share = float((squared <= _ELLIPSOID_95).mean())
        return cls(method, float(np.sqrt((distance**2).mean())), float(distance.max()), share)


@dataclass(frozen=True)
class Comparison:
    """Methods on the same tips, the rod first. tips: how many; seen: they are of the fit's own data."""

    data: str
    tips: int
    seen: bool
    length_m: float
    methods: tuple[MethodErrors, ...]

    @property
    def rod(self) -> MethodErrors:
        """The errors of the rod."""
        return self.methods[0]

    @property
    def best_baseline(self) -> MethodErrors:
        """The baseline with the smallest errors."""
        return min(self.methods[1:], key=lambda one: one.rms_m)

    @property
    def ratio(self) -> float:
        """Errors of the rod over those of the best baseline."""
        return self.rod.rms_m / max(self.best_baseline.rms_m, 1e-12)

    @property
    def sentence(self) -> str:
        """In words: which is better, and what that means."""
        best = self.best_baseline
        if not math.isfinite(self.ratio):
            return ""
        if self.ratio > 1 + _DIFFERENT:
            return (
                f"{self.data}: {best.method} is better than the rod ({1e3 * best.rms_m:.2f} against "
                f"{1e3 * self.rod.rms_m:.2f} mm): the rod lacks something that this arm does, as memory, unequal "
                "chambers or a mounting that is off. Do not read its parameters as properties of the material; predict "
                f"with {best.method} within the pressures of the fit"
            )
        if self.ratio < 1 - _DIFFERENT:
            return (
                f"{self.data}: the rod is better than the best baseline, {best.method} "
                f"({1e3 * self.rod.rms_m:.2f} against {1e3 * best.rms_m:.2f} mm)"
            )
        return f"{self.data}: the rod and {best.method} are equally good ({1e3 * self.rod.rms_m:.2f} mm)"


def on_left_out(
    fits: Sequence[BaselineFit], poses: Poses, rod_error_m: Array, rod_covariance_m2: Array, length_m: float
) -> Comparison:
    """The table of a run that was left out; errors (K, 3) and covariances (K, 3, 3) of the rod at all its entries."""
    seen = poses.has_tip
    rows = [MethodErrors.of(ROD, rod_error_m[seen], rod_covariance_m2[seen])]
    rows += [MethodErrors.of(one.name, poses.tip_m[seen] - one.predict(poses), one.covariance_m2) for one in fits]
    return Comparison(f"{poses.run_id} (left out)", int(seen.sum()), False, length_m, tuple(rows))


def on_blocks(fits: Sequence[BaselineFit], rod_error_m: Array, length_m: float) -> Comparison:
    """The table of the fit's own data, each block in time predicted from the others; errors (K, 3) of the rod."""
    rows = [MethodErrors.of(ROD, rod_error_m, None)]
    rows += [MethodErrors.of(one.name, one.block_error_m, None) for one in fits]
    return Comparison("blocks of the fit's data", len(rod_error_m), True, length_m, tuple(rows))


def facts(
    found: Sequence[Comparison], fits: Sequence[BaselineFit], floor: Repeatability | None
) -> Mapping[str, object]:
    """The tables for JSON."""
    return {
        "repeatability": None
        if floor is None
        else {"rms_mm": 1e3 * floor.rms_m, "states": floor.states, "repeats": floor.repeats},
        "baselines": [{"method": one.name, "lag_s": one.lag_s, "regularisation": one.weight} for one in fits],
        "tables": [
            {
                "data": one.data,
                "tips": one.tips,
                "sentence": one.sentence,
                "methods": [
                    {
                        "method": row.method,
                        "rms_mm": 1e3 * row.rms_m,
                        "largest_mm": 1e3 * row.largest_m,
                        "share_of_length": row.rms_m / one.length_m,
                        "share_in_95": None if math.isnan(row.share_in_95) else row.share_in_95,
                    }
                    for row in one.methods
                ],
            }
            for one in found
        ],
    }
