"""Identified parameters laid over a rig, and what `rig identify` prints."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from calibration.identify.bootstrap import bootstrap
from calibration.identify.data import Poses, poses_of
from calibration.identify.document import content
from calibration.identify.fit import Fit, identify
from calibration.identify.parameters import Prior, Setup
from rig.arm import model_arm
from rig.config import PA_PER_BAR, RigConfig, parse, path_of, text
from rig.listing import plain_json
from rig.parameters import laid_over
from rig.parameters import read as read_parameters
from rig.screens import console
from runs.run import Run

DEFAULT = ("law", "rpe_per_bar", "base", "sensor_offsets")
DEFAULT_HOMOGENEOUS = ("youngs_modulus_pa", "rpe_per_bar", "base", "sensor_offsets")


def rig_with(rig: str, parameters: Path) -> str:
    """The YAML of a rig with identified parameters in it, whatever model the rig had.

    Raises:
        BadInput: the rig, the parameter file, or that they do not belong together.
    """
    found = read_parameters(parameters)
    return laid_over(text(rig), path_of(rig), found, found.found.identified.variant)


def from_runs(archives: Sequence[Run], free: Sequence[str], priors: Mapping[str, Prior], starts: int = 1) -> Fit:
    """Identify the arm of some runs; where nothing is said, the start is the arm of the first run's rig.

    The sensors' accuracy, as their rig states it, is the prior of their offsets.
    """
    config = _rig_of(archives[0])
    chosen = tuple(free) or (DEFAULT_HOMOGENEOUS if config.model.variant.startswith("homogeneous") else DEFAULT)
    accuracy = max(sensor.accuracy_bar for sensor in config.sensors) * PA_PER_BAR / 2
    known = {"sensor_offsets": Prior(0.0, accuracy), **priors}
    data: list[Poses] = [poses_of(run) for run in archives]
    return identify(data, Setup(model_arm(config)), chosen, known, starts)


def show(fit: Fit, as_json: bool) -> None:
    """Estimates with their error bars or verdicts, and how well each run is met."""
    if as_json:
        typer.echo(json.dumps(plain_json(content(fit)), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "value", "+-", "95 %", "unit", "run"):
        table.add_column(head, justify="left" if head in ("parameter", "unit", "run") else "right")
    for e in fit.estimates:
        if e.value is None or e.std is None or e.interval is None:
            others = f" ({', '.join(e.partners)})" if e.partners else ""
            table.add_row(
                e.name, "-", "", Text(f"{e.verdict.value}{others}; held at {e.used:.5g}", "yellow"), e.unit, e.run
            )
        else:
            low, high = e.interval
            table.add_row(e.name, f"{e.value:.6g}", f"{e.std:.2g}", f"{low:.5g} .. {high:.5g}", e.unit, e.run)
    screen.print(table)
    for run in fit.runs:
        kind = "motion" if run.moving else "plateaus"
        before, after = 1e3 * run.rms_before_m, 1e3 * run.rms_m
        screen.print(
            f"{run.run_id} ({kind}): rms {before:.3f} -> {after:.3f} mm, {run.outliers} outliers", soft_wrap=True
        )
    if fit.discrepancy_m:
        screen.print(f"the model is off by {1e3 * fit.discrepancy_m:.3f} mm per axis beyond the stated errors")
    if not fit.solved:
        screen.print(Text("the search ended before it had converged", "yellow"))


def second_opinion(fit: Fit, samples: int, scheduler: str | None, store: Path | None) -> None:
    """Bootstrap error bars beside those of the likelihood, with a progress bar on the error stream."""
    screen = console(stderr=True)
    columns = (TextColumn("refitting"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True) as bar:
        job = bar.add_task("refitting", total=samples)
        found = bootstrap(
            fit, samples, scheduler=scheduler, store=store, progress=lambda done, _: bar.update(job, completed=done)
        )
    bars = {(e.name, e.run): e.std for e in fit.estimates}
    for name, run, std in zip(found.names, found.runs, found.std, strict=True):
        screen.print(f"{name} {run}: +- {std:.2g} by {samples} refits, {bars[name, run]:.2g} by the likelihood")


def _rig_of(run: Run) -> RigConfig:
    return parse(run.header.rig_yaml, f"{run.path}: the rig's YAML")
