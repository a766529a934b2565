"""Write the parameters of the recursive estimator after a run, in the format of `rig identify`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.identify.fitting.results import NORMAL_95, Estimate, RunFit, Verdict
from calibration.identify.presentation.parameters_document import write
from calibration.identify.unknowns.parameter import Parameter
from calibration.identify.unknowns.parameters import named
from calibration.identify.unknowns.setup import Setup
from rig.config.arm_model import model_arm
from rig.config.loader import recorded
from rig.config.sections import variant_named
from rig.identify.initial_setup import baseline_geometry
from runs.columns import Adaptation
from runs.records import DetectionStatus
from runs.run import Run

SUFFIX = ".parameters.yaml"
_UNDECIDED = 0.5
"""A standard deviation above this share of the plausible span makes a parameter undecided."""
_ONLY_PRIOR = 0.95


@dataclass(frozen=True)
class OnlineResult:
    """The estimates at the end of a run, as `presentation.parameters_document.IdentificationResult` needs them."""

    setup: Setup
    start: Setup
    estimates: tuple[Estimate, ...]
    covariance: NDArray[np.float64]
    runs: tuple[RunFit, ...]
    extra_m: float = 0.0

    @property
    def rms_m(self) -> float:
        """RMS of the live error over the whole run."""
        return self.runs[0].rms_m


def write_parameters(run: Run) -> Path | None:
    """Write a run's estimates beside its archive; return None without an estimator or a measured tip."""
    adaptation = run.adaptation
    if adaptation is None or not adaptation.used.any():
        return None
    estimated = found(run, adaptation)
    return write(estimated, run.path.with_suffix(SUFFIX), baseline=baseline_geometry(run, estimated.start))


def found(run: Run, adaptation: Adaptation) -> OnlineResult:
    """Return the estimates after the last frame, and the residuals of the run during estimation."""
    config = recorded(run.header, run.path).config
    start = Setup(model_arm(config, variant_named(run.header.model_variant)))
    parameters = named(adaptation.parameter, config.actuators)
    setup = start
    for parameter, value in zip(parameters, adaptation.value[-1], strict=True):
        setup = parameter.write(setup, float(value))
    seen = run.tip.seen == DetectionStatus.MEASURED
    measured = np.where(seen[:, None], run.tip.measured_mm, np.nan) * 1e-3
    met = RunFit(
        run_id=run.header.run_id,
        source=run.sha256,
        moving=True,
        frames=int((adaptation.used > 0).sum()),
        oriented=0,
        gap=measured - run.tip.model_mm * 1e-3,
        predicted_m=run.tip.model_mm * 1e-3,
        before_m=adaptation.start_model_mm * 1e-3,
        outliers=int((adaptation.used == 2).sum()),
        correlation=1.0,
        independent=float(np.isfinite(measured).sum()),
        setup=setup,
    )
    estimates = tuple(
        _estimate(parameter, adaptation, k, start, run.header.run_id) for k, parameter in enumerate(parameters)
    )
    return OnlineResult(setup, start, estimates, adaptation.covariance[-1], (met,))


def _estimate(parameter: Parameter, adaptation: Adaptation, k: int, start: Setup, run_id: str) -> Estimate:
    value, std = float(adaptation.value[-1, k]), float(adaptation.uncertainty[-1, k])
    verdict = Verdict.IDENTIFIED
    if std > _ONLY_PRIOR * adaptation.start_uncertainty[k]:
        verdict = Verdict.PRIOR
    elif std > _UNDECIDED * parameter.span(parameter.read(start)):
        verdict = Verdict.UNDECIDED
    known = verdict is Verdict.IDENTIFIED
    return Estimate(
        name=parameter.name,
        unit=parameter.unit,
        run=run_id if parameter.per_run else "",
        used=value,
        value=value if known else None,
        std=std if known else None,
        interval=(value - NORMAL_95 * std, value + NORMAL_95 * std) if known else None,
        verdict=verdict,
        partners=(),
        posterior_std=std,
    )
