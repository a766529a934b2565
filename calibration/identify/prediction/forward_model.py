"""Predictions of all runs and their derivatives by the unknowns: f(theta) and df/dtheta of the formula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from calibration.identify.observations.poses import Poses
from calibration.identify.prediction.tip_predictor import FINE_SUBSTEPS, SUBSTEPS, Predictor
from calibration.identify.unknowns.setup import Setup
from calibration.identify.unknowns.unknown import Unknown
from model.arrays import Array

# Step of an unknown, in spans, for the model's directional derivatives.
_STEP = 1e-7
# Derivatives and covariances of pressures are kept while no unknown has moved by more than these shares of its span.
_SAME_SLOPE, _SAME_COVARIANCE = 1e-5, 0.05
# Unknowns that show only in fast motion, for which the time steps must be fine.
_FAST = frozenset({"density_kg_m3", "damping_s", "sensor_lag_s"})


@dataclass
class ForwardModel:
    """Runs, the setup that the search begins at, and the unknowns theta (n,) in SI units.

    substeps, extrapolated: time steps of a motion, see `Predictor`; 0 substeps choose both by the unknowns.
    """

    data: Sequence[Poses]
    start: Setup
    unknowns: tuple[Unknown, ...]
    substeps: int = 0
    extrapolated: bool = False

    def __post_init__(self) -> None:
        if not self.substeps:
            fast = any(one.name in _FAST for one in self.unknowns)
            self.substeps, self.extrapolated = (FINE_SUBSTEPS, True) if fast else (SUBSTEPS, False)
        self._predictors = [Predictor(poses, self.substeps, self.extrapolated) for poses in self.data]
        self._kept_slopes: tuple[Array, list[Array]] | None = None
        self._kept_covariances: tuple[Array, list[Array]] | None = None
        self._runs_of_their_own = {one.run for one in self.unknowns if one.run is not None}
        self._setup = lru_cache(maxsize=64)(self._written)
        self.first = np.array([one.start for one in self.unknowns])
        self.span = np.array([one.span for one in self.unknowns])
        self.mean = np.array([one.mean for one in self.unknowns])
        self.std = np.array([one.std for one in self.unknowns])

    def measured_as(self, data: Sequence[Poses]) -> ForwardModel:
        """The same model with other tips, orientations and errors in the same runs; what is solved is kept."""
        other = replace(self, data=data)
        other._predictors = [replace(own, poses=poses) for own, poses in zip(self._predictors, data, strict=True)]
        other._kept_slopes = self._kept_slopes
        return other

    @property
    def measured(self) -> int:
        """Numbers measured: three per tip or point of a section, and three per orientation."""
        return int(sum(poses.measured.sum() for poses in self.data))

    def setup(self, theta: Array, run: int | None = None) -> Setup:
        """The setup at theta, with the values of run number `run`, if given."""
        return self._setup(tuple(theta.tolist()), run if run in self._runs_of_their_own else None)

    def _written(self, theta: tuple[float, ...], run: int | None) -> Setup:
        out = self.start
        for unknown, value in zip(self.unknowns, theta, strict=True):
            if unknown.run is None or unknown.run == run:
                out = unknown.write(out, value)
        return out

    def predicted(self, theta: Array) -> list[Array]:
        """Tips (K, 3) [m] of every run."""
        return [predictor(self.setup(theta, run)) for run, predictor in enumerate(self._predictors)]

    def rotations(self, theta: Array) -> list[Array]:
        """Orientations (K, 3, 3) of the tips of every run."""
        return [predictor.rotations(self.setup(theta, run)) for run, predictor in enumerate(self._predictors)]

    def sections(self, theta: Array) -> list[tuple[tuple[Array, Array], ...]]:
        """Points (K, 3) and orientations (K, 3, 3) of the sections of every run."""
        return [predictor.sections(self.setup(theta, run)) for run, predictor in enumerate(self._predictors)]

    def gaps(self, theta: Array) -> list[Array]:
        """Measured minus predicted (K, D) [m, rad] of every run; see `Predictor.gap`."""
        return [predictor.gap(self.setup(theta, run)) for run, predictor in enumerate(self._predictors)]

    def rms_m(self, theta: Array) -> float:
        """Root mean square distance [m] from measured to predicted tips."""
        squares = (np.concatenate([gap[:, :3] for gap in self.gaps(theta)]) ** 2).sum(axis=1)
        return float(np.sqrt(np.nanmean(squares)))

    def slopes(self, theta: Array) -> list[Array]:
        """Derivatives (K, D, n) of every run's predictions by the unknowns; zero where there is no solution."""
        kept = self._kept_slopes
        if kept is None or self._moved(theta, kept[0]) >= _SAME_SLOPE:
            found = [np.nan_to_num(self._slopes_of_run(theta, run), nan=0.0) for run in range(len(self.data))]
            self._kept_slopes = kept = (theta.copy(), found)
        return kept[1]

    def _slopes_of_run(self, theta: Array, run: int) -> Array:
        mine = [i for i, one in enumerate(self.unknowns) if one.run is None or one.run == run]
        base, perturbed, steps = self.setup(theta, run), [], []
        for i in mine:
            unknown = self.unknowns[i]
            step = _STEP * unknown.span
            # Backward at the upper bound.
            step = -step if theta[i] + step > unknown.upper else step
            perturbed.append(unknown.write(base, float(theta[i] + step)))
            steps.append(step)
        out = np.zeros((len(self.data[run]), self.data[run].numbers, len(self.unknowns)))
        out[:, :, mine] = self._predictors[run].slopes(base, perturbed, steps)
        return out

    def pressure_covariances(self, theta: Array) -> list[Array]:
        """Covariances (K, D, D) of every run's predictions by the errors of the measured pressures."""
        kept = self._kept_covariances
        if kept is None or self._moved(theta, kept[0]) > _SAME_COVARIANCE:
            found = [p.pressure_covariance(self.setup(theta, run)) for run, p in enumerate(self._predictors)]
            self._kept_covariances = kept = (theta.copy(), found)
        return kept[1]

    def _moved(self, theta: Array, other: Array) -> float:
        return float((np.abs(theta - other) / self.span).max(initial=0.0))
