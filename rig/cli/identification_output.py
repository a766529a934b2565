"""Output of `rig identify`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

import typer
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from calibration.identify.bootstrap import Bootstrap
from calibration.identify.held_out_prediction import Prediction
from calibration.identify.model_comparison import ComparisonRow
from calibration.identify.parameters_document import Baseline, content
from calibration.identify.profile_likelihood import LikelihoodProfile
from calibration.identify.results import Fit
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.identify.estimation import FitsByStart
from rig.identify.model_comparison import RunComparison
from rig.reproduce.identification import PaperEstimate, PaperEstimates

# Slow and fast models alternate, so the remaining time needs an average over a long period.
_SPEED_PERIOD_S = 3600.0


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error; yield a function to call with (done, total)."""
    screen = console(stderr=True)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(
        *columns,
        console=screen,
        transient=True,
        disable=not screen.is_terminal,
        speed_estimate_period=_SPEED_PERIOD_S,
    ) as bar:
        job = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(job, completed=done, total=total)


@contextmanager
def elapsed_time(what: str) -> Iterator[None]:
    """Show on standard error that a computation of unknown length runs, and for how long."""
    screen = console(stderr=True)
    columns = (TextColumn(what), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        bar.add_task("", total=None)
        yield


def notes(lines: Iterable[str]) -> None:
    """Print notes on standard error."""
    screen = console(stderr=True)
    for line in lines:
        screen.print(line, soft_wrap=True)


def fits_by_start(found: FitsByStart) -> None:
    """Print the likelihood from each initial rig, if there are several."""
    if len(found.fits) > 1:
        notes(
            f"from {name}: log likelihood {fit.log_likelihood:.1f}, rms {1e3 * fit.rms_m:.3f} mm"
            f"{', chosen' if name == found.best else ''}"
            for name, fit in found.fits.items()
        )


def estimates(fit: Fit, as_json: bool, under: Baseline | None = None) -> None:
    """Print the estimates with error bars or verdicts, and the residuals of each run."""
    if as_json:
        typer.echo(json.dumps(plain_json(content(fit, baseline=under)), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("parameter", "value", "+-", "95 %", "unit", "run"):
        table.add_column(head, justify="left" if head in ("parameter", "unit", "run") else "right", overflow="fold")
    undetermined = []
    for e, held in zip(fit.estimates, fit.fixed, strict=True):
        if e.value is None or e.std is None or e.interval is None:
            others = f" ({', '.join(e.partners)})" if e.partners else ""
            label = f"{e.name} {e.run}".strip()
            undetermined.append(
                f"{label}: {e.verdict.value}{others}; {'held at' if held else 'used'} {e.used:.5g} {e.unit}"
            )
        else:
            low, high = e.interval
            table.add_row(e.name, f"{e.value:.6g}", f"{e.std:.2g}", f"{low:.5g} .. {high:.5g}", e.unit, e.run)
    screen.print(table)
    for words in undetermined:
        screen.print(Text(words, "yellow"), soft_wrap=True)
    for run in fit.runs:
        kind = "motion" if run.moving else "plateaus"
        before, after = 1e3 * run.rms_before_m, 1e3 * run.rms_m
        screen.print(
            f"{run.run_id} ({kind}): rms {before:.3f} -> {after:.3f} mm, {run.outliers} outliers", soft_wrap=True
        )
    if fit.discrepancy_m:
        screen.print(f"the model is off by {1e3 * fit.discrepancy_m:.3f} mm per axis beyond the stated errors")
    if fit.drifts:
        screen.print(Text(fit.drifts, "yellow"), soft_wrap=True)
    for words in fit.open_directions:
        screen.print(Text(f"left open by the data: {words}", "yellow"), soft_wrap=True)
    if not fit.solved:
        screen.print(Text("the Gauss-Newton search did not converge", "yellow"))


def profile_intervals(found: Iterable[LikelihoodProfile]) -> None:
    """Print the intervals of profile likelihoods."""
    for one in found:
        ends = " .. ".join("open" if end is None else f"{end:.5g}" for end in one.interval)
        notes([f"{one.name}: 95 % by profile {'flat: not bounded by the data' if one.flat else ends}"])


def bootstrap_errors(fit: Fit, found: Bootstrap, samples: int) -> None:
    """Print bootstrap errors beside those of the likelihood."""
    bars = {(e.name, e.run): e.std for e in fit.estimates}
    notes(
        f"{name} {run}: +- {std:.2g} by {samples} refits, {bars[name, run]:.2g} by the likelihood"
        for name, run, std in zip(found.names, found.runs, found.std, strict=True)
    )


def prediction_errors(found: Sequence[Prediction]) -> None:
    """Print the prediction errors of held-out runs."""
    for one in found:
        how = ", under its measured wrench" if one.under_wrench else ""
        errors = f"rms {1e3 * one.rms_before_m:.3f} -> {1e3 * one.rms_m:.3f} mm, "
        errors += f"mean {1e3 * one.mean_m:.3f} mm, 95 % below {1e3 * one.p95_m:.3f} mm"
        if one.unsolved:
            errors += f"; {one.unsolved} of {len(one.error_m)} frames have no prediction and are excluded"
        notes([f"{one.run_id} (left out{how}): {errors}"])


def comparison(found: RunComparison, as_json: bool) -> None:
    """Print a model comparison as the paper's Table 3, and its conclusion."""
    compared = found.comparison
    if as_json:
        rows = [_row_facts(row) for row in compared.rows]
        facts = {"rows": rows, "best": compared.best.candidate.name, "sentence": compared.sentence}
        typer.echo(json.dumps(plain_json(facts), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("inhomogeneous", "radial effect", *(("damping",) if found.moving else ())):
        table.add_column(head)
    for head in ("error of runs left out [%]", "rms [mm]", "AIC", "BIC", "fitted"):
        table.add_column(head, justify="right")
    for row in compared.rows:
        _, _, rule = row.candidate.name.partition(", ")
        table.add_row(
            f"yes, {rule}" if row.candidate.inhomogeneous else "no",
            "yes" if row.candidate.radial else "no",
            *((_damping(row),) if found.moving else ()),
            f"{row.error_percent:.2f}",
            f"{1e3 * row.error_m:.3f}",
            f"{row.aic:.0f}",
            f"{row.bic:.0f}",
            str(row.dof),
        )
    screen.print(table)
    for run in found.shortened:
        kept = "first" if run.moving else "evenly spaced"
        screen.print(f"{run.run_id}: {run.frames} {kept} of {run.of_frames} frames are compared", soft_wrap=True)
    screen.print(compared.sentence, soft_wrap=True)


def _damping(row: ComparisonRow) -> str:
    """Return the damping of a row's model as text."""
    if not row.candidate.damping:
        return "no"
    return "yes, undecided" if row.damping_s is None else f"yes, {1e3 * row.damping_s:.1f} ms"


def _row_facts(row: ComparisonRow) -> dict[str, object]:
    return {
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


def paper_estimates(found: PaperEstimates, as_json: bool) -> None:
    """Print the quantities of section 5.2 of the paper."""
    if as_json:
        facts: dict[str, object] = {
            e.name: {"value": e.value, "std": e.std, "unit": e.unit, "r2": e.r2, "verdict": e.verdict or None}
            for e in found.estimates
        }
        typer.echo(json.dumps(plain_json({**facts, "published": found.published}), indent=2))
        return
    screen = console()
    table = Table(box=None, padding=(0, 2, 0, 0))
    for head in ("quantity", "value", "+-", "unit", "R^2"):
        table.add_column(head, justify="right" if head in ("value", "+-", "R^2") else "left")
    for e in found.estimates:
        table.add_row(e.name, *_paper_cells(e))
    screen.print(table)
    for line in found.missing:
        screen.print(line, soft_wrap=True)
    screen.print(f"The published E: {found.published}", soft_wrap=True)


def _paper_cells(e: PaperEstimate) -> tuple[str, str, str, str]:
    value = "-" if e.value is None else f"{e.value:.6g}"
    std = e.verdict if e.std is None else f"{e.std:.2g}"
    return value, std, e.unit, "" if e.r2 is None else f"{e.r2:.5f}"
