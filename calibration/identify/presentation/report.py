"""The report of an identification: one HTML file that holds everything it shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from calibration.identify.fitting.held_out_prediction import Prediction
from calibration.identify.fitting.results import Estimate, Fit
from calibration.identify.presentation import figures
from calibration.identify.presentation.notation import Scale, quantity, rounded, units_note
from runs.overwriting import write_text
from runs.report.drawing import svg
from runs.report.html import html_document


def write(
    fit: Fit,
    path: Path,
    warnings: Sequence[str] = (),
    left_out: Sequence[Prediction] = (),
    truth: Mapping[str, float] | None = None,
) -> Path:
    """Write the page. `truth`: the simulator's own values by parameter, where the runs were simulated."""
    known = truth or {}
    simulated = '<span class="badge simulated">simulated</span>' if known else ""
    parts = [
        f'<section class="run">\n<header class="run"><h1>Identification of an arm{simulated}</h1>\n'
        f'<p class="sub">{len(fit.runs)} runs, {fit.measured} numbers measured, {fit.fitted} fitted, '
        f"{escape(fit.setup.arm.variant)}</p></header>",
        _tiles(fit, left_out),
        _notes(warnings, bool(known)),
        _parameters(fit, known),
    ]
    rows = sum(1 for e in fit.estimates if e.std and not e.nuisance)
    drawn = [("Intervals", svg(figures.estimates, (9, 0.8 + 0.55 * rows), "e", fit, known))] if rows else []
    drawn.append(("Residuals over time, pressure and place", svg(figures.residuals, (9, 6.4), "r", fit)))
    drawn.append(("Are the residuals as stated? Normal quantiles", svg(figures.quantiles, (6, 3.8), "q", fit)))
    if fit.covariance.any():
        drawn.append(("Correlations", svg(figures.correlations, (6.5, 5.2), "c", fit)))
    if left_out:
        drawn.append(("Runs that were left out", svg(figures.predictions, (9, 2.3 * len(left_out)), "l", left_out)))
    parts += [f"<h2>{title}</h2>\n<figure>{drawing}</figure>" for title, drawing in drawn]
    parts += [_runs(fit, left_out), "</section>"]
    body = "\n".join(part for part in parts if part)
    write_text(path, html_document("Identification", "", body))
    return path


def _tiles(fit: Fit, left_out: Sequence[Prediction]) -> str:
    free = [e for e in fit.estimates if not e.nuisance]
    tiles = [
        (f"{1e3 * fit.rms_m:.3f} <small>mm</small>", "rms distance, measured to model"),
        (f"{1e3 * fit.extra_m:.3f} <small>mm</small>", "per axis that no stated error explains"),
        *_orientation_tile(fit),
        (f"{sum(e.identified for e in free)} <small>of {len(free)}</small>", "free parameters identified"),
    ]
    tiles += [(f"{1e3 * p.rms_m:.3f} <small>mm</small>", f"rms on {escape(p.run_id)}, left out") for p in left_out]
    return (
        '<div class="tiles">'
        + "".join(f'<div class="tile"><b>{v}</b><span>{t}</span></div>' for v, t in tiles)
        + "</div>"
    )


def _orientation_tile(fit: Fit) -> list[tuple[str, str]]:
    if not any(run.oriented for run in fit.runs):
        return []
    return [(f"{math.degrees(fit.rms_rad):.3g} <small>deg</small>", "rms angle, measured to model orientation")]


def _notes(warnings: Sequence[str], simulated: bool) -> str:
    notes = [f"{escape(words[0].upper() + words[1:])}." for words in warnings]
    if simulated:
        notes.insert(0, "<b>These runs were simulated.</b> Nothing here was measured on a real manipulator.")
    return "\n".join(f'<div class="note">{note}</div>' for note in notes)


def _parameters(fit: Fit, truth: Mapping[str, float]) -> str:
    heads = ["parameter", "run", "value", "95 %", "rig file or prior"] + ["truth"] * bool(truth)
    rows = []
    for e in fit.estimates:
        expected = "" if e.expected is None else quantity(e.name, e.unit, e.expected.mean, e.expected.std)
        cells = [e.name, e.run, *_value_cells(e), expected]
        if truth:
            cells.append(rounded(e.name, e.unit, truth[e.name], 5) if e.name in truth and not e.run else "")
        rows.append(cells)
    note = units_note({e.name: e.unit for e in fit.estimates})
    return f'<h2>Parameters</h2>\n<div class="scroll">{_table(heads, rows)}</div>{f"<p>{note}</p>" if note else ""}'


def _value_cells(e: Estimate) -> list[str]:
    if e.value is None or e.std is None or e.interval is None:
        others = f" ({', '.join(e.partners)})" if e.partners else ""
        return [f"{e.verdict.value}{others}", f"used {rounded(e.name, e.unit, e.used)}"]
    scale = Scale.of(e.name, e.unit, e.value, e.std)
    return [scale.with_uncertainty(e.value, e.std), f"{scale.interval(e.interval)}{scale.suffix}"]


def _runs(fit: Fit, left_out: Sequence[Prediction]) -> str:
    heads = ["run", "used as", "frames", "outliers", "rms before [mm]", "rms [mm]", "with orientation", "rms [deg]"]
    heads.append("SHA-256")
    rows = [
        [
            run.run_id,
            "motion" if run.moving else "plateaus",
            str(run.frames),
            str(run.outliers),
            f"{1e3 * run.rms_before_m:.3f}",
            f"{1e3 * run.rms_m:.3f}",
            str(run.oriented),
            f"{run.rms_deg:.3g}" if run.oriented else "",
            run.source,
        ]
        for run in fit.runs
    ]
    rows += [
        [p.run_id, "left out", "", "", f"{1e3 * p.rms_before_m:.3f}", f"{1e3 * p.rms_m:.3f}", "", "", ""]
        for p in left_out
    ]
    left = "".join(
        f'<div class="note">{escape(p.run_id)} leaves the range of the fit: {escape(words)}</div>'
        for p in left_out
        for words in p.outside
    )
    return f'<h2>Data</h2>\n<div class="scroll">{_table(heads, rows)}</div>{_sections(fit, left_out)}{left}'


def _sections(fit: Fit, left_out: Sequence[Prediction]) -> str:
    """The measured sections that count, and those of runs that were left out."""
    heads = ["run", "section", "at [mm]", "frames", "rms [mm]", "with orientation", "rms [deg]"]
    rows = [
        [
            run,
            one.name,
            f"{1e3 * one.at_m:g}",
            str(one.frames),
            f"{1e3 * one.rms_m:.3f}",
            str(one.oriented),
            f"{one.rms_deg:.3g}" if one.oriented else "",
        ]
        for run, sections in (*((r.run_id, r.sections) for r in fit.runs), *((p.run_id, p.sections) for p in left_out))
        for one in sections
    ]
    return f'<h2>Measured sections</h2>\n<div class="scroll">{_table(heads, rows)}</div>' if rows else ""


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(h)}</th>" for h in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"
