"""Result of an identification: estimates with verdicts, fits of the runs, information criteria."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from calibration.identify.least_squares import LeastSquaresProblem
from calibration.identify.likelihood import Discrepancy
from calibration.identify.model_error_posterior import ModelErrorPosterior
from calibration.identify.parameter import Prior
from calibration.identify.parameters import known
from calibration.identify.poses import Poses, section_kind
from calibration.identify.setup import Setup
from calibration.identify.solution import Solution
from model.arrays import Array

NORMAL_95 = 1.959963984540054
# An estimate that is more standard uncertainties away from what was known of it is reported.
TENSION = 3.0
# Standard uncertainty after the fit over the stated one, above which an estimate counts as less certain than before.
_LESS_CERTAIN = 1.1


class Verdict(StrEnum):
    """Result for one parameter."""

    IDENTIFIED = "identified"
    NO_EFFECT = "no effect on the data"
    UNDECIDED = "the data leave it open"
    ENTANGLED = "only in combination with others"
    OBSCURED = "errors of the model leave it open"
    PRIOR = "known from its prior alone"


def rms(distance_m: Array) -> float:
    """Root mean square of the finite distances (K,) [m]; NaN if there are none."""
    known = distance_m[np.isfinite(distance_m)]
    return float(np.sqrt((known**2).mean())) if len(known) else math.nan


@dataclass(frozen=True)
class Estimate:
    """One free parameter. `value`, `std` and `interval` are None if it is not identified.

    used: the value in the fit, for every verdict. run: the run of a per-run parameter, empty for a shared one.
    partners: parameters that it is exchangeable with. joint_std: standard deviation in the joint fit of all unknowns.
    nuisance: not free, but estimated with its stated value as prior. prior: as it entered the fit. stated: value and
    uncertainty before the fit, also where they did not enter it.
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
    joint_std: float
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
        return (self.used - self.stated.mean) / math.hypot(self.stated.std, max(self.joint_std, self.std or 0.0))

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
    """Parameters of an arm.

    setup: with every shared `used` value, and the means of the identified values per run. covariance (n, n): of the
    fitted values, in the order of `estimates`; zero for fixed parameters, whose assumed error of half a span enters the
    other error bars. joint_covariance (n, n): of all unknowns with that error of the fixed ones, in spans. Both include
    the model error; fitted_covariance (n, n) is `covariance` without it. discrepancy: standard deviations per axis of
    the model error that the stated errors do not explain.
    """

    setup: Setup
    start: Setup
    estimates: tuple[Estimate, ...]
    covariance: Array
    joint_covariance: Array = field(repr=False)
    fitted_covariance: Array = field(repr=False)
    runs: tuple[RunFit, ...]
    log_likelihood: float
    loss: float
    discrepancy: Discrepancy
    measured: int
    fitted: int
    starts: int
    agreeing_starts: int
    solved: bool
    open_directions: tuple[str, ...]
    """Undetermined combinations of parameters: the null space of the information matrix, as text."""
    worse_than_start: bool
    """The starting parameters explain the data better: the search failed, and no number counts."""
    start_losses: tuple[float, ...]
    """-2 ln L at the end of the search from each starting point, relative to the best."""
    problem: LeastSquaresProblem = field(repr=False)
    solution: Solution = field(repr=False)
    model_error: ModelErrorPosterior | None = field(default=None, repr=False)
    """What the residuals leave possible of errors of the model; None where what is not free counts as exact."""

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; of a per-run parameter that of the first run."""
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise KeyError(name)

    @property
    def fixed(self) -> tuple[bool, ...]:
        """Which estimates are fixed at their start as undetermined, in the order of `estimates`."""
        return tuple((np.diagonal(self.covariance) == 0).tolist())

    @property
    def std(self) -> tuple[float, ...]:
        """Standard uncertainties, in the order of `estimates`; zero for fixed ones."""
        return tuple(np.sqrt(np.diagonal(self.covariance)).tolist())

    @property
    def in_tension(self) -> tuple[Estimate, ...]:
        """Estimates more than three standard uncertainties from what was known of them."""
        return tuple(e for e in self.estimates if abs(e.tension) > TENSION)

    @property
    def less_certain(self) -> tuple[Estimate, ...]:
        """Estimates whose uncertainty is clearly above what was stated: errors of the model may have moved them."""
        return tuple(
            e for e, std in zip(self.estimates, self.std, strict=True) if e.prior and std > _LESS_CERTAIN * e.prior.std
        )

    def contributions(self, estimate: Estimate) -> tuple[tuple[Estimate, float], ...]:
        """The estimates whose prior uncertainty enters that of `estimate`, with the share of its variance [0, 1].

        Largest first; what remains comes from the data and from the model error. By the covariance C of the fit, and
        the variance v of the estimate: (C_ij / prior_j)^2 / v.
        """
        i = self.estimates.index(estimate)
        variance = max(self.covariance[i, i], self.fitted_covariance[i, i])
        found = [
            (other, float((self.fitted_covariance[i, j] / other.prior.std) ** 2 / variance))
            for j, other in enumerate(self.estimates)
            if other.prior is not None and variance > 0
        ]
        return tuple(sorted(found, key=lambda one: -one[1]))

    def by_model_error(self, estimate: Estimate) -> float:
        """The share of the variance of an estimate that comes from the model error, [0, 1]."""
        i = self.estimates.index(estimate)
        variance = self.covariance[i, i]
        return max(0.0, 1 - float(self.fitted_covariance[i, i] / variance)) if variance > 0 else 0.0

    @property
    def drifts(self) -> str:
        """Warning about runs with drifting residuals; empty if there are none."""
        names = ", ".join(run.run_id for run in self.runs if run.drifting)
        return f"what is left of {names} drifts as slowly as the run: error bars may be too narrow" if names else ""

    @property
    def discrepancy_m(self) -> float:
        """Discrepancy of the tips [m]."""
        return self.discrepancy.tip_m

    @property
    def rms_rad(self) -> float:
        """Root mean square angle over all measured orientations; NaN without any."""
        return rms(np.concatenate([run.angle_rad for run in self.runs]))

    @property
    def rms_m(self) -> float:
        """Root mean square distance over all measured tips."""
        return rms(np.concatenate([run.error_m for run in self.runs]))

    @property
    def penalised_log_likelihood(self) -> float:
        """Log likelihood of the data, less half the squared distances from the priors: implausible values cost."""
        gaps = self.problem.prior_rows(self.solution.z)[1]
        return self.log_likelihood - 0.5 * float(gaps @ gaps)

    @property
    def aic(self) -> float:
        """Akaike information criterion (AIC), penalised by the priors; the discrepancy counts as one parameter."""
        return 2 * (self.fitted + 1) - 2 * self.penalised_log_likelihood

    @property
    def bic(self) -> float:
        """Bayesian information criterion (BIC, Schwarz), penalised by the priors.

        The sample size is the number of independent numbers of single frames, so that it does not matter whether the
        frames of a plateau were averaged before.
        """
        count = sum(run.independent for run in self.runs)
        return float((self.fitted + 1) * np.log(max(count, 2.0)) - 2 * self.penalised_log_likelihood)
