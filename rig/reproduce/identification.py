"""`rig identify --paper`: section 5.2 of the paper from the archives of its two extension experiments."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import typer
from rich.table import Table

from calibration.identify import Estimate, NoDataError, at_rest
from calibration.identify.paper_identification import (
    Elongation,
    PaperIdentification,
    elongation,
    identify_paper,
    published_modulus,
)
from model.tube import Tube
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.identify.estimation import from_runs
from rig.identify.initial_setup import setup_of
from runs.run import Run

# Where the fit of section 3 begins, and what it leaves as it is: stiff fibres, nearly around the tube.
_SHEAR_MODULUS_PA, _FIBRE_MODULUS_PA, _FIBRE_ANGLE_DEG = 100e3, 3e6, 3.0
_EQUAL_PA = 5e3
Line = tuple[str, str, str, str, str]


def print_estimates(archives: Sequence[Run], as_json: bool) -> None:
    """Print E, a1, a2, the free strain, mu and R_m with their R^2, and gamma where a run bends the arm.

    Raises:
        NoDataError: no run has weights on the arm, or the arm is not at rest.
    """
    weights, pressures, bending = _sorted(archives)
    geometry = setup_of(archives[0]).arm.geometry
    middle = (geometry.inner_radius_m + geometry.outer_radius_m) / 2
    tube = Tube(
        geometry.inner_radius_m, middle, geometry.outer_radius_m, _SHEAR_MODULUS_PA, _FIBRE_MODULUS_PA, _FIBRE_ANGLE_DEG
    )
    found = identify_paper(weights, pressures, geometry, tube)
    gamma = None
    if bending:
        fit = from_runs(archives, ["law", "rpe_per_bar", "cap_mass_kg", "shear_ratio", "base", "sensor_offsets"], {})
        gamma = fit["shear_ratio"]
    lines = [*_lines(found), *_gamma(gamma)]
    if as_json:
        facts: dict[str, Any] = {
            name: {"value": _plain(value), "std": _plain(std), "unit": unit, "r2": _plain(r2)}
            for name, value, std, unit, r2 in lines
        }
        typer.echo(json.dumps(plain_json({**facts, "published": published_modulus().explanation}), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("quantity", "value", "+-", "unit", "R^2"):
        table.add_column(head, justify="right" if head in ("value", "+-", "R^2") else "left")
    for line in lines:
        table.add_row(*line)
    screen.print(table)
    if pressures is None:
        screen.print("no run stretches the arm by equal pressures: a of eq 30, mu and R_m are not identified")
    if not bending:
        screen.print("no run bends the arm: gamma is not identified")
    screen.print(f"The published E: {published_modulus().explanation}", soft_wrap=True)


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


def _lines(found: PaperIdentification) -> list[Line]:
    soft = found.softening
    std1, std2 = np.sqrt(np.diagonal(soft.covariance))
    lines = [
        (
            "E, line through the origin",
            f"{found.modulus_pa:.6g}",
            f"{found.modulus_std_pa:.2g}",
            "Pa",
            _r2(found.modulus_r2),
        ),
        ("a1 of eq 32", f"{soft.a1_per_n:.6g}", f"{std1:.2g}", "1/N", _r2(soft.r2)),
        ("a2 of eq 32", f"{soft.a2_per_n2:.6g}", f"{std2:.2g}", "1/N^2", _r2(soft.r2)),
    ]
    if found.rpe_measured is not None:
        a = found.rpe_measured
        lines.append(
            ("a of eq 30, push on the caps taken off", f"{a.slope:.5g}", f"{a.slope_std:.2g}", "1/bar", _r2(a.r2))
        )
    if found.tube is not None:
        units = {"shear_modulus_pa": ("mu", "Pa"), "interface_radius_m": ("R_m", "m")}
        for name, std in zip(found.tube.free, found.tube.std, strict=True):
            label, unit = units.get(name, (name, ""))
            value = getattr(found.tube.tube, name)
            lines.append(
                (f"{label} of eqs 1-6", f"{value:.5g}", "not decided" if std is None else f"{std:.2g}", unit, "")
            )
        reach = f"a of eq 30 by the tube, to {found.tube.rpe_to_pa / 1e5:.2f} bar"
        lines.append((reach, f"{found.tube.rpe_per_bar:.5g}", "", "1/bar", _r2(found.tube.rpe_r2)))
        lines.append(("strain that eqs 1-6 do not meet, rms", f"{found.tube.rms_strain:.2g}", "", "1", ""))
    return lines


def _gamma(gamma: Estimate | None) -> list[Line]:
    if gamma is None:
        return []
    if gamma.value is None or gamma.std is None:
        return [("gamma", "-", gamma.verdict.value, "1", "")]
    return [("gamma, by maximum likelihood over all runs", f"{gamma.value:.4g}", f"{gamma.std:.2g}", "1", "")]


def _plain(text: str) -> float | str | None:
    """A cell of the table as JSON has it."""
    try:
        return float(text) if text else None
    except ValueError:
        return text


def _r2(value: float) -> str:
    return f"{value:.5f}"
