"""`rig identify` in the terminal: reads and refits with progress bars, and prints the results."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import typer
from rich.text import Text

from calibration.baselines.comparison import facts as comparison_facts
from calibration.identify import Poses, Prior
from calibration.identify.comparison.model_comparison import ComparisonRow
from calibration.identify.fitting.held_out_prediction import Prediction
from calibration.identify.fitting.results import Estimate, Fit, RunFit, SectionFit
from calibration.identify.presentation.notation import Scale, quantity, rounded, units_note
from calibration.identify.presentation.parameters_document import content, section_facts
from rig.cli.baseline_output import methods_table
from rig.cli.output import ColumnTable, console, print_json
from rig.cli.progress import progress_bar
from rig.cli.run_names import resolve
from rig.identify.estimation import read_poses
from rig.identify.from_archives import Identification, OpenedRuns, open_runs
from rig.identify.model_comparison import RunComparison
from rig.identify.warnings import expected
from runs.run import Run


def results(lines: Iterable[str], beside_json: bool) -> None:
    """Print lines on standard output; on standard error beside JSON, or for notes."""
    screen = console(stderr=beside_json)
    for line in lines:
        screen.print(line, soft_wrap=True)


def priors_of(items: Sequence[str]) -> dict[str, Prior]:
    """Return the priors of `--prior`, as NAME=MEAN+-STD."""
    priors: dict[str, Prior] = {}
    for item in items:
        name, _, numbers = item.partition("=")
        mean, _, std = numbers.partition("+-")
        if name in priors:
            raise typer.BadParameter(f"{name} is given twice", param_hint="--prior")
        try:
            known = float(mean), float(std)
        except ValueError as fault:
            raise typer.BadParameter(f"'{item}' is not of the form NAME=MEAN+-STD", param_hint="--prior") from fault
        try:
            priors[name] = Prior(*known)
        except ValueError as fault:
            raise typer.BadParameter(f"'{item}': {fault}", param_hint="--prior") from fault
    return priors


def opened(archives: Sequence[Path], leave_out: Sequence[Path] = (), *, one_arm: bool = False) -> OpenedRuns:
    """Open the runs to identify from, and those left out; print notes on them."""
    unseen = [resolve(name) for name in leave_out]
    found = open_runs([resolve(name) for name in archives], unseen, one_arm=one_arm)
    results(found.notes, beside_json=True)
    return found


def read(archives: Sequence[Run], quasi_static: bool) -> list[Poses]:
    """Read runs, with a progress bar."""
    if not archives:
        return []
    with progress_bar("reading") as progress:
        return read_poses(archives, quasi_static, progress)


def identification(done: Identification, warnings: Sequence[str], as_json: bool) -> None:
    """Print the conclusion, the estimates, the errors beside the baselines, and those of runs that were held out."""
    if as_json:
        _print_json(done, warnings)
    else:
        for line in done.conclusion:
            console().print(line, soft_wrap=True)
        if done.pressure_lag_s:
            lag = f"The tip follows the pressures behind a lag of {done.pressure_lag_s:g} s"
            console().print(f"{lag}, which blocks left out of the fit's data chose.", soft_wrap=True)
        console().print()
        _estimates(done.fit, warnings)
        methods_table(done.comparisons, done.repeatability)
    _prediction_errors(done.predictions, as_json)


def _print_json(done: Identification, warnings: Sequence[str]) -> None:
    """Print the content of a parameter file, the warnings, the comparison and the predictions, as JSON."""
    facts = content(done.fit, done.baseline) | {
        "conclusion": list(done.conclusion),
        "warnings": list(warnings),
        "noise": done.fit.noise_model,
        "pressure_lag_s": done.pressure_lag_s,
        "comparison": comparison_facts(done.comparisons, done.baselines, done.repeatability),
        "predictions": [_prediction_facts(one) for one in done.predictions],
    }
    print_json(facts)


def _prediction_facts(found: Prediction) -> dict[str, object]:
    return {
        "run": found.run_id,
        "rms_before_mm": 1e3 * found.rms_before_m,
        "rms_mm": 1e3 * found.rms_m,
        "mean_mm": 1e3 * found.mean_m,
        "std_mm": 1e3 * found.std_m,
        "share_in_95": dict(zip(("x", "y", "z", "ellipsoid"), found.share_in_95.tolist(), strict=True)),
        "outside_fit": list(found.outside),
        **({"sections": [section_facts(one) for one in found.sections]} if found.sections else {}),
        "time_s": found.time_s.tolist(),
        "measured_mm": (1e3 * found.measured_m).tolist(),
        "predicted_mm": (1e3 * found.predicted_m).tolist(),
        "interval_95_mm": (1e3 * found.interval_m).tolist(),
        "covariance_mm2": (1e6 * found.covariance_m2).tolist(),
    }


def _estimates(fit: Fit, warnings: Sequence[str]) -> None:
    """Print the estimates with error bars or verdicts, what was not free, the warnings and the residuals."""
    screen = console()
    free = [one for one in fit.estimates if not one.nuisance]
    table = ColumnTable("parameter", "value", "95 %", "rig file or prior", "run")
    undetermined = []
    for e in free:
        if e.value is None or e.std is None or e.interval is None:
            undetermined.append(_verdict(e))
        else:
            scale = Scale.of(e.name, e.unit, e.value, e.std)
            ends = f"{scale.interval(e.interval)}{scale.suffix}"
            table.add_row(e.name, scale.with_uncertainty(e.value, e.std), ends, expected(e), e.run)
    screen.print(table)
    if note := units_note({e.name: e.unit for e in free}):
        screen.print(note, soft_wrap=True)
    for words in undetermined:
        screen.print(Text(words, "yellow"), soft_wrap=True)
    _not_free(fit)
    for words in warnings:
        screen.print(Text(f"{words[0].upper()}{words[1:]}.", "yellow"), soft_wrap=True)
    for run in fit.runs:
        _residuals(run)


def _verdict(e: Estimate) -> str:
    others = f" ({', '.join(e.partners)})" if e.partners else ""
    label, std = f"{e.name} {e.run}".strip(), rounded(e.name, e.unit, e.posterior_std, 2)
    return f"{label}: {e.verdict.value}{others}; used {rounded(e.name, e.unit, e.used)} +- {std}"


def _not_free(fit: Fit) -> None:
    """Print the parameters that were not free: as stated, and as the fit moved them."""
    beside = [one for one in fit.estimates if one.nuisance]
    if not beside:
        return
    screen = console()
    screen.print(
        "Not free, yet moved by the fit within the stated standard uncertainty, which is in the error bars above; a "
        "parameter file gets these values, too:",
        soft_wrap=True,
    )
    table = ColumnTable("parameter", "stated", "after the fit", "run")
    for one in beside:
        table.add_row(one.name, expected(one), quantity(one.name, one.unit, one.used, one.posterior_std), one.run)
    screen.print(table)


def _residuals(run: RunFit) -> None:
    kind = "motion" if run.moving else "plateaus"
    before = "live error" if run.before_live else "error of the initial parameters"
    text = (
        f"{run.run_id} ({kind}): rms {1e3 * run.rms_before_m:.3f} -> {1e3 * run.rms_m:.3f} mm, {run.outliers} outliers"
    )
    where = "in the frames used" if run.moving else "on the plateaus"
    text = f"{text}; before: {before} {where}"
    if run.oriented:
        text += f"; orientation of the tip used in {run.oriented} of {run.frames} frames: rms {run.rms_deg:.3g} deg"
    console().print(text, soft_wrap=True)
    if run.sections:
        console().print(f"{run.run_id}: sections used: {_sections(run.sections)}", soft_wrap=True)


def _sections(sections: Sequence[SectionFit]) -> str:
    """How many frames of each section count, and how far they are from the model."""
    words = []
    for one in sections:
        text = f"{one.name} at {1e3 * one.at_m:g} mm in {one.frames} frames, rms {1e3 * one.rms_m:.3f} mm"
        words.append(f"{text} and {one.rms_deg:.3g} deg" if one.oriented else text)
    return "; ".join(words)


def _prediction_errors(found: Sequence[Prediction], beside_json: bool) -> None:
    for one in found:
        how = ", under its measured wrench" if one.under_wrench else ""
        errors = f"rms {1e3 * one.rms_before_m:.3f} -> {1e3 * one.rms_m:.3f} mm, "
        errors += f"mean {1e3 * one.mean_m:.3f} mm, 95 % below {1e3 * one.p95_m:.3f} mm"
        x, y, z, whole = (f"{100 * share:.0f} %" for share in one.share_in_95)
        errors += f"; stated {1e3 * one.std_m:.3f} mm; in their 95 % intervals: x {x}, y {y}, z {z}, ellipsoid {whole}"
        if one.unsolved:
            errors += f"; {one.unsolved} of {len(one.error_m)} frames have no prediction and are excluded"
        results([f"{one.run_id} (left out{how}): {errors}"], beside_json)
        if one.sections:
            results([f"{one.run_id} (left out): sections: {_sections(one.sections)}"], beside_json)


def comparison(found: RunComparison, as_json: bool) -> None:
    """Print a model comparison as the paper's Table 3, and its conclusion."""
    compared = found.comparison
    if as_json:
        rows = [_row_facts(row) for row in compared.rows]
        facts = {"rows": rows, "best": compared.best.candidate.name, "sentence": compared.sentence}
        print_json(facts)
        return
    screen = console()
    words = ("inhomogeneous", "radial effect", *(("damping",) if found.moving else ()))
    table = ColumnTable(*words, numbers=("error of runs left out [%]", "rms [mm]", "AIC", "BIC", "fitted"))
    for row in compared.rows:
        _, _, rule = row.candidate.name.partition(", ")
        table.add_row(
            ", ".join(part for part in ("yes" if row.candidate.inhomogeneous else "no", rule) if part),
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
