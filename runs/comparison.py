"""Several runs side by side: the table of their errors, and their tips and errors overlaid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

from matplotlib.figure import Figure

from runs.figures import POINTS, across, legend, svg, thin
from runs.run import Run
from runs.summary import Summary
from runs.text import plain, three

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = ("-", (0, (6, 1.5)), (0, (6, 1.5, 1, 1.5)))


def section(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the part of a report that compares its runs."""
    salt = "/".join(run.header.run_id for run in runs)
    height = 3.4 + 0.16 * len(runs)
    drawings = (
        (
            "Tips in the plane of motion",
            svg(tips, (9, height), salt, runs, summaries),
            "Lines: measured. Dotted: model.",
        ),
        ("Errors over the protocol", svg(errors, (9, height), salt, runs, summaries), "Measured to model."),
    )
    shown = "".join(
        f"<h2>{title}</h2>\n<figure>{drawing}<figcaption>{caption}</figcaption></figure>\n"
        for title, drawing, caption in drawings
    )
    head = f'<header class="run"><h1>{len(runs)} runs</h1></header>'
    return f'<section class="run">\n{head}\n{table(runs, summaries)}{shown}</section>\n'


def table(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the errors of each run: the mean normalised one of the paper's Table 3, rms per axis of Table 5."""
    names = (
        "run",
        "model",
        "status",
        "mean error<br>[mm]",
        "settled<br>[mm]",
        "normalised<br>[%]",
        "rms x, y, z<br>[mm]",
        "largest<br>[mm]",
        "measured<br>[%]",
    )
    head = "".join(f"<th{'' if i < 3 else ' class=n'}>{name}</th>" for i, name in enumerate(names))
    rows = "".join(_row(run, summary) for run, summary in zip(runs, summaries, strict=True))
    return f'<div class="scroll"><table><tr>{head}</tr>{rows}</table></div>\n'


def _row(run: Run, s: Summary) -> str:
    header = run.header
    simulated = " <small>(simulated)</small>" if s.simulated else ""
    words = (f"{escape(header.run_id)}{simulated}", escape(header.model_variant), escape(s.status))
    numbers = (
        plain(s.error_mm.mean, 2),
        plain(s.settled_error_mm, 2),
        plain(s.normalised_percent, 2),
        three(s.rmse_mm, 2),
        plain(s.error_mm.max, 2),
        plain(100 * s.measured_fraction, 1),
    )
    cells = "".join(f"<td>{word}</td>" for word in words) + "".join(f"<td class=n>{n}</td>" for n in numbers)
    return f"<tr>{cells}</tr>"


def tips(figure: Figure, runs: Sequence[Run], summaries: Sequence[Summary]) -> None:
    """Measured and modelled tips of every run."""
    axes = figure.subplots()
    names = set()
    for run, summary, colour, style in _coloured(runs, summaries):
        project, name = across(run, summary)
        names.add(name)
        every = max(len(run.tip.time_s) // (4 * POINTS), 1)
        if summary.frames_measured:
            axes.plot(*project(run.tip.measured_mm[::every]).T, color=colour, ls=style, lw=1.2, label=run.header.run_id)
        else:
            axes.plot([], [], color=colour, ls=style, label=run.header.run_id)
        axes.plot(*project(run.tip.model_mm[::every]).T, color=colour, lw=0.9, ls=":")
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.set_xlabel(f"{' / '.join(sorted(names))} [mm]")
    axes.set_ylabel("z, along the arm [mm]")
    legend(axes, columns=2)


def errors(figure: Figure, runs: Sequence[Run], summaries: Sequence[Summary]) -> None:
    """Error of every run over protocol time, so that runs that waited differently still lie on one another."""
    axes = figure.subplots()
    for run, summary, colour, style in _coloured(runs, summaries):
        if summary.frames_measured:
            line = thin(run.tip.protocol_s, run.tip.error_mm)
            axes.plot(*line, color=colour, ls=style, lw=1.0, label=run.header.run_id)
    axes.set_xlabel("protocol time [s]")
    axes.set_ylabel("error [mm]")
    axes.set_ylim(bottom=0)
    legend(axes, columns=2)


def _coloured(runs: Sequence[Run], summaries: Sequence[Summary]) -> Iterator[tuple[Run, Summary, str, Any]]:
    """Yield each run with its colour and line: every pair is another, up to three times the colours."""
    for i, (run, summary) in enumerate(zip(runs, summaries, strict=True)):
        yield run, summary, COLOURS[i % len(COLOURS)], STYLES[i // len(COLOURS) % len(STYLES)]
