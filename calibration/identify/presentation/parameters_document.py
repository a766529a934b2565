"""The result as YAML: what to lay over a rig's file, every estimate, their covariance and the data they rest on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import yaml
from numpy.typing import NDArray

from calibration.identify.fitting.results import Estimate, RunFit, SectionFit
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.setup import Setup
from model.material import Material
from model.units import MM_PER_M, PA_PER_BAR
from runs.overwriting import write_text

VERSION = 2
# Residuals of a motion that are written out: enough to draw, few enough to read.
_MAX_RESIDUALS = 100


@dataclass(frozen=True)
class Baseline:
    """Identified parameters that the rig of the runs already had; new estimates are relative to them.

    setup: how they mount and measure the arm. geometry: of the rig beneath them, as a document holds it; None where the
    search did not begin at the rig with them in it.
    """

    setup: Setup
    geometry: Mapping[str, Any] | None


class IdentificationResult(Protocol):
    """What a document is made of: a `Fit`, or what a recursive estimator has found. Members are those of `Fit`."""

    @property
    def setup(self) -> Setup:
        """With what was found."""

    @property
    def start(self) -> Setup:
        """As it was known before."""

    @property
    def estimates(self) -> Sequence[Estimate]:
        """One for each free parameter."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of the estimates (n, n)."""

    @property
    def runs(self) -> Sequence[RunFit]:
        """The runs that were used."""

    @property
    def rms_m(self) -> float:
        """Over all of them."""

    @property
    def extra_m(self) -> float:
        """By how much the model is off beyond the stated errors."""


def write(fit: IdentificationResult, path: Path, baseline: Baseline | None = None) -> Path:
    """Write the fit; what was not identified is in the overlay with the value that the fit used, and says so."""
    document = content(fit, baseline)
    # A key without a value is an error in every file that people edit: what is not known is left out.
    document["estimates"] = [{key: x for key, x in e.items() if x is not None} for e in document["estimates"]]
    text = yaml.safe_dump(document, sort_keys=False, width=120, default_flow_style=None)
    head = "# Identified parameters of an arm. Lay them over a rig: --parameters FILE.\n"
    write_text(path, head + text)
    return path


def content(fit: IdentificationResult, baseline: Baseline | None = None) -> dict[str, Any]:
    """Everything of a fit that a later reader needs, in plain numbers.

    The overlay is relative to the rig without parameters; the estimates are relative to the rig with `baseline`.
    """
    setup = fit.setup if baseline is None else fit.setup.without_baseline(baseline.setup)
    start = fit.start.arm
    geometry = _geometry(fit.start) if baseline is None or baseline.geometry is None else dict(baseline.geometry)
    return {
        "softrig_parameters": VERSION,
        "identified": {"variant": start.variant, "geometry": geometry},
        "arm": _arm(setup),
        "mounting": _mounting(setup),
        "sensing": {"gain": [float(x) for x in setup.sensor_gain], "lag_s": float(setup.sensor_lag_s)},
        **({} if baseline is None else {"estimates_count_from": _baseline_values(baseline.setup)}),
        "estimates": [
            {
                "name": e.name,
                "unit": e.unit,
                **({"run": e.run} if e.run else {}),
                "verdict": e.verdict.value,
                "value": e.value,
                "std": e.std,
                "interval_95": list(e.interval) if e.interval else None,
                "used": e.used,
                **({"exchangeable_with": list(e.partners)} if e.partners else {}),
                **({"held": True} if e.nuisance else {}),
                **({"prior": _prior(e.prior)} if e.prior else {}),
                **({"stated": _prior(e.stated)} if e.stated else {}),
            }
            for e in fit.estimates
        ],
        "covariance": np.asarray(fit.covariance, dtype=float).tolist(),
        "residuals": {"rms_mm": MM_PER_M * fit.rms_m, "extra_std_mm": MM_PER_M * fit.extra_m},
        "data": [
            {
                "run": run.run_id,
                "sha256": run.source,
                "used_as": "motion" if run.moving else "plateaus",
                "frames": run.frames,
                "outliers": run.outliers,
                "rms_before_mm": MM_PER_M * run.rms_before_m,
                "rms_mm": MM_PER_M * run.rms_m,
                **({"oriented_frames": run.oriented, "rms_deg": math.degrees(run.rms_rad)} if run.oriented else {}),
                **({"sections": [section_facts(one) for one in run.sections]} if run.sections else {}),
                "residual_mm": _residuals(run),
            }
            for run in fit.runs
        ],
    }


def section_facts(one: SectionFit) -> dict[str, object]:
    """What a file states of a section: where it is, how many frames count, and how far it is from the model."""
    found: dict[str, object] = {"name": one.name, "at_mm": MM_PER_M * one.at_m, "frames": one.frames}
    found["rms_mm"] = MM_PER_M * one.rms_m
    return found | ({"oriented_frames": one.oriented, "rms_deg": one.rms_deg} if one.oriented else {})


def _prior(prior: Prior) -> dict[str, float]:
    return {"mean": float(prior.mean), "std": float(prior.std)}


def _mounting(setup: Setup) -> dict[str, list[float]]:
    return {
        "base_translation_mm": [MM_PER_M * x for x in setup.base_translation_m],
        "base_rotation_deg": [math.degrees(x) for x in setup.base_rotation_rad],
        "tool_offset_mm": [MM_PER_M * x for x in setup.tool_offset_m],
        "tool_rotation_deg": [math.degrees(x) for x in setup.tool_rotation_rad],
    }


def _baseline_values(setup: Setup) -> dict[str, Any]:
    return {"mounting": _mounting(setup), "gain": [float(x) for x in setup.sensor_gain]}


def _residuals(run: RunFit) -> list[list[float]]:
    """Measured minus predicted [mm], to a tenth of a micrometre; of a motion a hundred rows, evenly spaced."""
    known = run.residual_m[np.isfinite(run.residual_m).all(axis=1)]
    chosen = np.unique(np.linspace(0, len(known) - 1, min(len(known), _MAX_RESIDUALS)).round().astype(int))
    rows: list[list[float]] = np.round(MM_PER_M * known[chosen if run.moving else slice(None)], 4).tolist()
    return rows


def material_section(material: Material) -> dict[str, float]:
    """Return the keys of a material in rig and parameter files, without the branches of its memory."""
    return {
        "youngs_modulus_pa": material.youngs_modulus_pa,
        "a1_per_N": material.a1_per_n,
        "a2_per_N2": material.a2_per_n2,
        "rpe_per_bar": material.rpe_per_bar,
        "shear_ratio": material.shear_ratio,
        "density_kg_m3": material.density_kg_m3,
        "damping_s": material.damping_s,
    }


def _arm(setup: Setup) -> dict[str, Any]:
    arm = setup.turned_arm
    material = arm.material
    return {
        "geometry": _geometry(setup),
        "material": {
            **material_section(material),
            "branches": [{"relative_modulus": b.relative_modulus, "time_s": b.time_s} for b in material.branches],
        },
        "actuation": {
            "law": arm.actuation.name,
            "growth_per_bar": arm.actuation.growth_per_bar,
            "stops": [{"weight": s.weight, "width_bar": s.width_pa / PA_PER_BAR} for s in arm.actuation.stops],
        },
        "cap_mass_g": 1e3 * arm.cap_mass_kg,
    }


def _geometry(setup: Setup) -> dict[str, Any]:
    geometry = setup.turned_arm.geometry
    x, y = geometry.positions_m.T
    return {
        "length_mm": MM_PER_M * geometry.length_m,
        "inner_radius_mm": MM_PER_M * geometry.inner_radius_m,
        "outer_radius_mm": MM_PER_M * geometry.outer_radius_m,
        "circle_radius_mm": float(MM_PER_M * np.hypot(x, y).mean()),
        "actuator_angles_deg": np.degrees(np.arctan2(y, x)).tolist(),
    }
