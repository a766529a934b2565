"""Section 5.2 of the paper, its own identification, from the archives of its two extension experiments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identify import Estimate, NoDataError, at_rest
from calibration.identify.paper_identification import (
    Elongation,
    PaperIdentification,
    elongation,
    identify_paper,
    published_modulus,
)
from model.tube import Tube
from rig.identify.estimation import from_runs
from rig.identify.initial_setup import setup_of
from runs.run import Run

# Where the fit of section 3 begins, and what it leaves as it is: stiff fibres, nearly around the tube.
_SHEAR_MODULUS_PA, _FIBRE_MODULUS_PA, _FIBRE_ANGLE_DEG = 100e3, 3e6, 3.0
_EQUAL_PA = 5e3


@dataclass(frozen=True)
class PaperEstimate:
    """One quantity of section 5.2: value, standard uncertainty, unit and R^2; None where the data do not give it."""

    name: str
    value: float | None
    std: float | None
    unit: str
    r2: float | None = None
    verdict: str = ""
    """Why there is no uncertainty."""


@dataclass(frozen=True)
class PaperEstimates:
    """The quantities, what the runs do not identify, and how the printed E came about."""

    estimates: tuple[PaperEstimate, ...]
    missing: tuple[str, ...]
    published: str


def estimate(archives: Sequence[Run]) -> PaperEstimates:
    """Return E, a1, a2, the free strain, mu and R_m with their R^2, and gamma where a run bends the arm.

    Raises:
        NoDataError: no run has weights on the arm, or the arm is not at rest.
    """
    weights, pressures, bending = _sorted(archives)
    geometry = setup_of(archives[0]).arm.geometry
    middle = (geometry.inner_radius_m + geometry.outer_radius_m) / 2
    tube = Tube(
        geometry.inner_radius_m, middle, geometry.outer_radius_m, _SHEAR_MODULUS_PA, _FIBRE_MODULUS_PA, _FIBRE_ANGLE_DEG
    )
    found = [*_from_extension(identify_paper(weights, pressures, geometry, tube))]
    missing = []
    if pressures is None:
        missing.append("no run stretches the arm by equal pressures: a of eq 30, mu and R_m are not identified")
    if bending:
        fit = from_runs(archives, ["law", "rpe_per_bar", "cap_mass_kg", "shear_ratio", "base", "sensor_offsets"], {})
        found.append(_gamma(fit["shear_ratio"]))
    else:
        missing.append("no run bends the arm: gamma is not identified")
    return PaperEstimates(tuple(found), tuple(missing), published_modulus().explanation)


def _sorted(archives: Sequence[Run]) -> tuple[Elongation, Elongation | None, bool]:
    """Elongations under weights and under pressure, and whether any run bends the arm."""
    weights: Elongation | None = None
    pressures: Elongation | None = None
    bending = False
    for run in archives:
        poses = at_rest(run)
        length = setup_of(run).arm.geometry.length_m
        if (poses.weight_kg > 0).any():
            weights = _only(weights, elongation(poses, length), run, "hangs weights on the arm")
        elif (np.ptp(poses.pressure_pa, axis=1) < _EQUAL_PA).all():
            pressures = _only(pressures, elongation(poses, length), run, "stretches the arm by equal pressures")
        else:
            bending = True
    if weights is None:
        raise NoDataError("the paper's identification needs a run under weights: rig run extension-weights")
    return weights, pressures, bending


def _only(before: Elongation | None, found: Elongation, run: Run, what: str) -> Elongation:
    """The one run of its kind that section 5.2 takes."""
    if before is not None:
        raise NoDataError(f"{run.path}: a second run that {what}; give one of them")
    return found


def _from_extension(found: PaperIdentification) -> list[PaperEstimate]:
    soft = found.softening
    std1, std2 = (float(std) for std in np.sqrt(np.diagonal(soft.covariance)))
    estimates = [
        PaperEstimate("E, line through the origin", found.modulus_pa, found.modulus_std_pa, "Pa", found.modulus_r2),
        PaperEstimate("a1 of eq 32", soft.a1_per_n, std1, "1/N", soft.r2),
        PaperEstimate("a2 of eq 32", soft.a2_per_n2, std2, "1/N^2", soft.r2),
    ]
    if (a := found.rpe_measured) is not None:
        name = "a of eq 30, push on the caps taken off"
        estimates.append(PaperEstimate(name, a.slope, a.slope_std, "1/bar", a.r2))
    if (fitted := found.tube) is not None:
        units = {"shear_modulus_pa": ("mu", "Pa"), "interface_radius_m": ("R_m", "m")}
        for name, std in zip(fitted.free, fitted.std, strict=True):
            label, unit = units.get(name, (name, ""))
            undecided = "not decided" if std is None else ""
            value = getattr(fitted.tube, name)
            estimates.append(PaperEstimate(f"{label} of eqs 1-6", value, std, unit, verdict=undecided))
        reach = f"a of eq 30 by the tube, to {fitted.rpe_to_pa / 1e5:.2f} bar"
        estimates.append(PaperEstimate(reach, fitted.rpe_per_bar, None, "1/bar", fitted.rpe_r2))
        estimates.append(PaperEstimate("strain that eqs 1-6 do not meet, rms", fitted.rms_strain, None, "1"))
    return estimates


def _gamma(gamma: Estimate) -> PaperEstimate:
    if gamma.value is None or gamma.std is None:
        return PaperEstimate("gamma", None, None, "1", verdict=gamma.verdict.value)
    return PaperEstimate("gamma, by maximum likelihood over all runs", gamma.value, gamma.std, "1")
