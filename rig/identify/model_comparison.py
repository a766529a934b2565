"""`rig identify --choose`: model comparison in the form of the paper's Table 3."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import typer
from rich.table import Table

from calibration.identify.model_comparison import ComparisonRow, ModelComparison, candidates, compare_models, compared
from calibration.identify.parameters import Prior
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.identify.estimation import check_priors, progress_bar, read_poses
from rig.identify.initial_setup import setup_of
from runs.run import Run


def comparison_lines(
    archives: Sequence[Run],
    free: Sequence[str],
    priors: Mapping[str, Prior],
    quasi_static: bool,
    as_json: bool,
    scheduler: str | None = None,
    store: Path | None = None,
) -> None:
    """Compare the models on several runs by cross-validation; print the table and the conclusion.

    `free`: parameters that are free in every model beside its law; by default the pose of the base. scheduler, store:
    as for the bootstrap.

    Raises:
        UnknownParameter: a name is unknown, or a prior belongs to a parameter that is free in no model.
    """
    start = setup_of(archives[0])
    every = read_poses(archives, quasi_static)
    data = [compared(one) for one in every]
    moving = any(one.moving for one in data)
    models_to_fit = candidates(start, free or ("base",), moving)
    check_priors(priors, [name for one in models_to_fit for name in one.free], start.arm.geometry.actuators)
    with progress_bar("fitting") as progress:
        found = compare_models(data, models_to_fit, priors, scheduler=scheduler, store=store, progress=progress)
    if as_json:
        typer.echo(json.dumps(plain_json(_facts(found)), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    models = ("inhomogeneous", "radial effect", *(("damping",) if moving else ()))
    for head in models:
        table.add_column(head)
    for head in ("error of runs left out [%]", "rms [mm]", "AIC", "BIC", "fitted"):
        table.add_column(head, justify="right")
    for row in found.rows:
        _, _, rule = row.candidate.name.partition(", ")
        table.add_row(
            f"yes, {rule}" if row.candidate.inhomogeneous else "no",
            "yes" if row.candidate.radial else "no",
            *((_damping(row),) if moving else ()),
            f"{row.error_percent:.2f}",
            f"{1e3 * row.error_m:.3f}",
            f"{row.aic:.0f}",
            f"{row.bic:.0f}",
            str(row.dof),
        )
    screen.print(table)
    for whole, part in zip(every, data, strict=True):
        if len(part) < len(whole):
            kept = "first" if whole.moving else "evenly spaced"
            screen.print(f"{whole.run_id}: {len(part)} {kept} of {len(whole)} frames are compared", soft_wrap=True)
    screen.print(found.sentence, soft_wrap=True)


def _damping(row: ComparisonRow) -> str:
    """Return the damping of a row's model as text."""
    if not row.candidate.damping:
        return "no"
    return "yes, undecided" if row.damping_s is None else f"yes, {1e3 * row.damping_s:.1f} ms"


def _facts(found: ModelComparison) -> dict[str, object]:
    rows = [
        {
            "model": row.candidate.name,
            "inhomogeneous": row.candidate.inhomogeneous,
            "radial_effect": row.candidate.radial,
            "damping": row.candidate.damping,
            "damping_s": row.damping_s,
            "left_out_percent": row.error_percent,
            "left_out_rms_mm": 1e3 * row.error_m,
            "aic": row.aic,
            "bic": row.bic,
            "fitted": row.dof,
        }
        for row in found.rows
    ]
    return {"rows": rows, "best": found.best.candidate.name, "sentence": found.sentence}
