"""The result as YAML: an overlay for a rig's file, with every estimate, their covariance and the data they rest on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from calibration.identify.fit import Fit
from calibration.identify.parameters import Setup

VERSION = 1
_MM = 1e3


class BadParameters(ValueError):  # noqa: N818 - the outcome is the name
    """A parameter file that cannot be used."""


@dataclass(frozen=True)
class Overlay:
    """What a parameter file changes: `rig` is laid over a rig's file, key by key; mm and degrees as there.

    The mounting is that of `Setup`: the rod base in the measurements' frame, and the measured point in the tip frame.
    """

    rig: dict[str, Any]
    base_translation_mm: tuple[float, float, float]
    base_rotation_deg: tuple[float, float, float]
    tool_offset_mm: tuple[float, float, float]


def write(fit: Fit, path: Path) -> Path:
    """Write the fit; what was not identified is in the overlay with the value it was held at, and says so."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(content(fit), sort_keys=False, width=120, default_flow_style=None)
    head = "# Identified parameters of an arm. Lay them over a rig: --parameters FILE.\n"
    path.write_text(head + text, encoding="utf-8")
    return path


def content(fit: Fit) -> dict[str, Any]:
    """Everything of a fit that a later reader needs, in plain numbers."""
    setup = fit.setup
    return {
        "softrig_parameters": VERSION,
        "rig": {"arm": _arm(setup), "model": {"variant": setup.arm.variant}},
        "mounting": {
            "base_translation_mm": [_MM * x for x in setup.base_translation_m],
            "base_rotation_deg": [math.degrees(x) for x in setup.base_rotation_rad],
            "tool_offset_mm": [_MM * x for x in setup.tool_offset_m],
        },
        "modulus_rule": setup.arm.modulus_rule,
        "sensor_lag_s": float(setup.sensor_lag_s),
        "sensor_gain": [float(x) for x in setup.sensor_gain],
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
            }
            for e in fit.estimates
        ],
        "covariance": np.asarray(fit.covariance, dtype=float).tolist(),
        "residuals": {"rms_mm": _MM * fit.rms_m, "discrepancy_mm": _MM * fit.discrepancy_m},
        "data": [
            {
                "run": run.run_id,
                "sha256": run.source,
                "used_as": "motion" if run.moving else "plateaus",
                "frames": run.frames,
                "outliers": run.outliers,
                "rms_before_mm": _MM * run.rms_before_m,
                "rms_mm": _MM * run.rms_m,
            }
            for run in fit.runs
        ],
    }


def read(path: Path) -> Overlay:
    """Read a parameter file.

    Raises:
        BadParameters: it is none, or is from a newer softrig.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
        version = data["softrig_parameters"]
        mounting = data["mounting"]
        triples = [
            (float(x), float(y), float(z))
            for x, y, z in (
                mounting[key] for key in ("base_translation_mm", "base_rotation_deg", "tool_offset_mm")
            )
        ]  # fmt: skip
        rig = dict(data["rig"])
    except OSError as fault:
        raise BadParameters(f"{path}: {fault.strerror or fault}") from fault
    except (yaml.YAMLError, KeyError, TypeError, ValueError, UnicodeDecodeError) as fault:
        raise BadParameters(f"{path}: not a file of parameters as 'rig identify' writes it ({fault})") from fault
    if version != VERSION:
        raise BadParameters(f"{path} is of version {version}; this softrig knows version {VERSION}")
    return Overlay(rig, *triples)


def _arm(setup: Setup) -> dict[str, Any]:
    arm = setup.turned_arm
    geometry, material = arm.geometry, arm.material
    xy = geometry.positions_m
    radii = np.hypot(xy[:, 0], xy[:, 1])
    return {
        "geometry": {
            "length_mm": _MM * geometry.length_m,
            "inner_radius_mm": _MM * geometry.inner_radius_m,
            "outer_radius_mm": _MM * geometry.outer_radius_m,
            "circle_radius_mm": float(_MM * radii.mean()),
            "actuator_angles_deg": np.degrees(np.arctan2(xy[:, 1], xy[:, 0])).tolist(),
        },
        "material": {
            "youngs_modulus_pa": material.youngs_modulus_pa,
            "a1_per_N": material.a1_per_n,
            "a2_per_N2": material.a2_per_n2,
            "rpe_per_bar": material.rpe_per_bar,
            "shear_ratio": material.shear_ratio,
            "density_kg_m3": material.density_kg_m3,
            "damping_s": material.damping_s,
        },
        "cap_mass_g": 1e3 * arm.cap_mass_kg,
    }
