"""Result of an identification: estimates with verdicts, fits of the runs, information criteria."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from calibration.identify.fitting.noise import Noise
from calibration.identify.fitting.objective import Objective
from calibration.identify.observations.poses import TIP, Poses, section_kind
from calibration.identify.prediction.forward_model import ForwardModel
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.parameters import known
from calibration.identify.unknowns.setup import Setup
from model.arrays import Array

NORMAL_95 = 1.959963984540054
# An estimate that is more standard uncertainties away from what was known of it is reported.
TENSION = 3.0


class Verdict(StrEnum):
    """Result for one parameter."""

    IDENTIFIED = "identified"
    NO_EFFECT = "no effect on the data"
    UNDECIDED = "the data leave it open"
    ENTANGLED = "only in combination with others"
    ABSENT = "not distinguished from zero"
    PRIOR = "known from its prior alone"


def rms(distance_m: Array) -> float:
    """Root mean square of the finite distances (K,) [m]; NaN if there are none."""
    known = distance_m[np.isfinite(distance_m)]
    return float(np.sqrt((known**2).mean())) if len(known) else math.nan


@dataclass(frozen=True)
class Estimate:
    """One free parameter. `value`, `std` and `interval` are None if it is not identified.

    used: the value in the fit, for every verdict. run: the run of a per-run parameter, empty for a shared one.
    partners: parameters that it is exchangeable with. posterior_std: standard deviation for every verdict. nuisance:
    not free, but estimated with its stated value as prior. prior: as it entered the fit, where it is a statement.
    stated: value and uncertainty before the fit, also where they did not enter it.
    """

    name: str
    unit: str
    run: str
    used: float
    value: float | None
    std: float | None
    interval: tuple[float, float] | None
    verdict: Verdict
    partners: tuple[str, ...]
    posterior_std: float
    nuisance: bool = False
    prior: Prior | None = None
    stated: Prior | None = None

    @property
    def expected(self) -> Prior | None:
        """What was known of it before the fit, if anything: its prior, else its stated value."""
        return self.prior or self.stated

    @property
    def tension(self) -> float:
        """Distance from what was known of it, in standard uncertainties; zero if nothing was known.

        A stated value that did not enter the fit is compared with both uncertainties.
        """
        if self.prior is not None:
            return (self.used - self.prior.mean) / self.prior.std
        if self.stated is None:
            return 0.0
        return (self.used - self.stated.mean) / math.hypot(self.stated.std, self.posterior_std)

    @property
    def identified(self) -> bool:
        """Whether the data determine it."""
        return self.value is not None


def with_means_of_runs(setup: Setup, estimates: Sequence[Estimate]) -> Setup:
    """The setup with each parameter that has a value per run at the mean of those that are identified."""
    for name, parameter in known(setup.arm.geometry.actuators).items():
        values = [e.value for e in estimates if e.name == name and e.run and e.value is not None]
        if values:
            setup = parameter.write(setup, float(np.mean(values)))
    return setup


@dataclass(frozen=True)
class SectionFit:
    """Fit of one section of the arm in one run; frames, oriented: camera frames whose point and orientation count.

    rms_m: root mean square distance from measured to predicted points; rms_rad: the same of orientations, NaN without.
    """

    name: str
    at_m: float
    frames: int
    oriented: int
    rms_m: float
    rms_rad: float

    @property
    def rms_deg(self) -> float:
        """The rms angle in degrees."""
        return math.degrees(self.rms_rad)

    @classmethod
    def every(cls, poses: Poses, gap: Array) -> tuple[SectionFit, ...]:
        """Of all sections of a run, from gaps (K, D) measured minus predicted."""
        out = []
        for one in poses.sections:
            at = poses.columns(section_kind(one.name))
            used, turned = one.seen & poses.has_tip, one.oriented & poses.has_tip
            angle = np.linalg.norm(gap[:, at.stop : at.stop + 3], axis=1) if turned.any() else np.empty(0)
            frames, oriented = int(poses.frames[used].sum()), int(poses.frames[turned].sum())
            distance = np.linalg.norm(gap[used, at], axis=1)
            out.append(
                cls(one.name, one.at_m, frames, oriented, rms(distance), rms(angle[turned] if len(angle) else angle))
            )
        return tuple(out)


@dataclass(frozen=True)
class RunFit:
    """Fit of one run. gap (K, D): measured minus predicted, tips [m] and rotations [rad]; NaN without a measurement.

    oriented: number of frames whose orientation was used. sections: the same of each measured section.
    """

    run_id: str
    source: str
    moving: bool
    frames: int
    oriented: int
    gap: Array
    predicted_m: Array
    before_m: Array
    """Tips of the model that ran beside the experiment, or else predictions of the starting setup."""
    outliers: int
    correlation: float
    independent: float
    """Independent numbers that were measured, in frames."""
    setup: Setup
    before_live: bool = False
    """`before_m` is of the model that ran beside the experiment."""
    drifting: bool = False
    """The residuals correlate over more than a tenth of the run; error bars include this only as far as it shows."""
    sections: tuple[SectionFit, ...] = ()

    @property
    def residual_m(self) -> Array:
        """Measured minus predicted tips (K, 3)."""
        return self.gap[:, :3]

    @property
    def angle_rad(self) -> Array:
        """Angles (K,) between measured and predicted orientations, measured entries only."""
        angle: Array = np.linalg.norm(self.gap[:, 3:6], axis=1)
        return angle[np.isfinite(angle)] if self.oriented else np.empty(0)

    @property
    def rms_rad(self) -> float:
        """Root mean square angle from measured to predicted orientations; NaN without any."""
        return rms(self.angle_rad)

    @property
    def rms_deg(self) -> float:
        """The same in degrees."""
        return math.degrees(self.rms_rad)

    @property
    def error_m(self) -> Array:
        """Distance from measured to predicted (K,), measured entries only."""
        error: Array = np.linalg.norm(self.residual_m, axis=1)
        return error[np.isfinite(error)]

    @property
    def rms_m(self) -> float:
        """Root mean square distance from measured to predicted."""
        return rms(self.error_m)

    @property
    def rms_before_m(self) -> float:
        """The same before the fit."""
        return rms(np.linalg.norm(self.residual_m + self.predicted_m - self.before_m, axis=1))


@dataclass(frozen=True)
class Fit:
    """Parameters of an arm: the minimum theta (n,) of an objective, in the order of `estimates`, and its covariance.

    setup: with every shared value, and the means of the identified values per run. covariance (n, n): by the curvature
    of the objective at its minimum.
    """

    setup: Setup
    start: Setup
    estimates: tuple[Estimate, ...]
    theta: Array
    covariance: Array
    runs: tuple[RunFit, ...]
    objective: Objective = field(repr=False)
    solved: bool
    noise_model: str

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; of a per-run parameter that of the first run."""
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise KeyError(name)

    @property
    def forward(self) -> ForwardModel:
        """The runs, the unknowns and their predictions."""
        return self.objective.forward

    @property
    def noise(self) -> Noise:
        """The covariance of measured minus predicted."""
        return self.objective.noise

    @property
    def measured(self) -> int:
        """Numbers measured."""
        return self.forward.measured

    @property
    def fitted(self) -> int:
        """Free parameters, those of each run counted."""
        return sum(not one.nuisance for one in self.estimates)

    @property
    def std(self) -> tuple[float, ...]:
        """Standard uncertainties, in the order of `estimates`."""
        return tuple(np.sqrt(np.diagonal(self.covariance)).tolist())

    @property
    def in_tension(self) -> tuple[Estimate, ...]:
        """Estimates more than three standard uncertainties from what was known of them."""
        return tuple(e for e in self.estimates if abs(e.tension) > TENSION)

    def contributions(self, estimate: Estimate) -> tuple[tuple[Estimate, float], ...]:
        """The estimates whose prior uncertainty enters that of `estimate`, with the share of its variance [0, 1].

        Largest first; what remains comes from the data. By the covariance C of the fit, and the variance v of the
        estimate: (C_ij / prior_j)^2 / v.
        """
        i = self.estimates.index(estimate)
        variance = self.covariance[i, i]
        found = [
            (other, float((self.covariance[i, j] / other.prior.std) ** 2 / variance))
            for j, other in enumerate(self.estimates)
            if other.prior is not None
        ]
        return tuple(sorted(found, key=lambda one: -one[1]))

    @property
    def drifts(self) -> str:
        """Warning about runs with drifting residuals; empty if there are none."""
        names = ", ".join(run.run_id for run in self.runs if run.drifting)
        return f"what is left of {names} drifts as slowly as the run: error bars may be too narrow" if names else ""

    @property
    def extra_m(self) -> float:
        """Standard deviation [m] per axis of the tips that no stated error explains."""
        return self.noise.extra.get(TIP, 0.0)

    @property
    def rms_rad(self) -> float:
        """Root mean square angle over all measured orientations; NaN without any."""
        return rms(np.concatenate([run.angle_rad for run in self.runs]))

    @property
    def rms_m(self) -> float:
        """Root mean square distance over all measured tips."""
        return rms(np.concatenate([run.error_m for run in self.runs]))

    @property
    def log_posterior(self) -> float:
        """Log likelihood of the data, less half the squared distances from the priors: implausible values cost."""
        return -0.5 * (self.objective.value(self.theta) + sum(one.log_det for one in self.noise.runs))

    @property
    def aic(self) -> float:
        """Akaike information criterion (AIC), penalised by the priors; the extra variance counts as one parameter."""
        return 2 * (self.fitted + 1) - 2 * self.log_posterior

    @property
    def bic(self) -> float:
        """Bayesian information criterion (BIC, Schwarz), penalised by the priors.

        The sample size is the number of independent numbers of single frames, so that it does not matter whether the
        frames of a plateau were averaged before.
        """
        count = sum(run.independent for run in self.runs)
        return float((self.fitted + 1) * np.log(max(count, 2.0)) - 2 * self.log_posterior)
