"""Several runs compared: the tables of their errors and settings, and their tips and errors overlaid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from html import escape

from matplotlib.figure import Figure

from runs.report import differences, overlay, repeats
from runs.report.drawing import FigureSpecification, decimated, legend, path_indices, svg
from runs.report.figures import across
from runs.report.further_figures import distance_mm
from runs.report.gaps import tip_with_gaps
from runs.report.html_table import html_table, listed, plain, three
from runs.run import Run
from runs.summary import Summary


def section(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the part of a report that compares its runs."""
    salt = "/".join(run.header.run_id for run in runs)
    shown = "".join(
        f"<h2>{figure.title}</h2>\n<figure>{svg(figure.draw, figure.size, salt, runs, summaries)}"
        f"<figcaption>{figure.caption}</figcaption></figure>\n"
        for figure in comparison_figures(runs)
    )
    head = f'<header class="run"><h1>{len(runs)} runs</h1></header>'
    papers = f'<div class="beside">{by_model(runs, summaries)}{by_axis(runs, summaries)}</div>\n'
    simulated = ", ".join(escape(s.run_id) for s in summaries if s.simulated)
    mark = f'<p class="note"><b>Simulated:</b> {simulated}; nothing here was measured on a real manipulator.</p>\n'
    found = differences.table(runs) + repeats.section(runs)
    note = "<p class=small><code>rig report RUN</code> writes the whole report of one run.</p>\n"
    tables = table(runs, summaries) + by_controller(runs, summaries)
    parts = (head, mark if simulated else "", tables, found, papers, shown, note)
    return f'<section class="run">\n{"".join(parts)}</section>\n'


def comparison_figures(runs: Sequence[Run]) -> tuple[FigureSpecification, ...]:
    """Return the figures that compare runs."""
    size, beneath = overlay.size(len(runs), 3.4), overlay.caption(len(runs))
    where = "Each in its plane of motion, or over x where it keeps to none."
    return (
        FigureSpecification("tips", "Tips", tips, size, f"Lines: measured. Dotted: model. {where}{beneath}"),
        FigureSpecification("errors", "Errors over the protocol", errors, size, f"Measured to model.{beneath}"),
        *_reference_distances(runs),
        *_tip_differences(runs),
    )


def _reference_distances(runs: Sequence[Run]) -> Iterator[FigureSpecification]:
    """Yield the figure of the tips' distances from their references, if more than one run follows a path."""
    if (count := len(_on_a_path(runs))) > 1:
        caption = f"Of the true tip where a run was simulated, else of the measured one.{overlay.caption(count)}"
        title, size = "Distance from the reference", overlay.size(count, 2.8)
        yield FigureSpecification("reference", title, reference_distances, size, caption)


def _tip_differences(runs: Sequence[Run]) -> Iterator[FigureSpecification]:
    """Yield the figure of the distances between tips of equal steps, if each of these runs has measured one."""
    equal = differences.of_equal_steps(runs)
    if len(equal) > 1 and len(differences.tips_at_equal_times(equal)[0]):
        others = len(equal) - 1
        caption = "Measured tips at equal protocol times, interpolated between frames; no line in gaps of the frames."
        caption += overlay.caption(others)
        if len(equal) < len(runs):
            caption += " Runs with other steps are left out."
        title = "Distance between the tips"
        yield FigureSpecification("differences", title, differences.draw, overlay.size(others, 2.8), caption)


def by_model(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the mean normalised error of each model in the shape of the paper's Table 3; nothing without one.

    What was simulated has rows of its own: no mean is over both.
    """
    known: dict[tuple[str, bool], list[float]] = {}
    for run, summary in zip(runs, summaries, strict=True):
        if math.isfinite(summary.normalised_percent):
            known.setdefault((run.header.model_variant, summary.simulated), []).append(summary.normalised_percent)
    rows = [
        (
            _check_mark(model.startswith("inhomogeneous")),
            _check_mark(model.endswith("+rpe")),
            plain(sum(errors) / len(errors), 2),
            f"{len(errors)}{_marked(simulated)}",
        )
        for (model, simulated), errors in sorted(known.items())
    ]
    table = html_table(("inhomogeneity", "radial pressure effect", "|error| [%]", "runs"), rows, words=2)
    title = "<h2>Normalised error by model</h2>"
    caption = "<p class=small>As the paper's Table 3: the mean over the settled steps of all runs.</p>"
    return f"<div>{title}\n{table}{caption}</div>" if table else ""


def by_axis(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the rms errors of each run as the paper's Table 5, with y; nothing where nothing was measured.

    A case is its protocol, as in the paper; where several runs had the same one and the same model, the run.
    """
    cases = Counter((run.header.protocol_name, run.header.model_variant) for run in runs)
    alike = max(cases.values(), default=0) > 1
    rows = [
        (
            f"{escape(run.header.run_id if alike else run.header.protocol_name)}{_marked(s.simulated)}",
            escape(run.header.model_variant),
            *(plain(s.rmse_mm[axis], 4) for axis in (2, 0, 1)),
        )
        for run, s in zip(runs, summaries, strict=True)
        if math.isfinite(s.rmse_mm[0])
    ]
    table = html_table(("case", "model", "z [mm]", "x [mm]", "y [mm]"), rows, words=2)
    title = "<h2>Root mean square error by direction</h2>"
    caption = "<p class=small>As the paper's Table 5, and the direction y: over every frame.</p>"
    return f"<div>{title}\n{table}{caption}</div>" if table else ""


def by_controller(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the errors of each run on its tip paths, as true as they are known; nothing without a path."""
    rows = []
    for run, s in zip(runs, summaries, strict=True):
        if s.tip_path is None:
            continue
        error, learned = s.tip_path.truth or s.tip_path.measured, run.header.learned_from
        rows.append(
            (
                f"{escape(run.header.run_id)}{_marked(s.simulated)}",
                escape(run.header.tip_controller),
                escape(", ".join(learned)),
                plain(error.rms_mm, 3),
                plain(error.lag_mm, 3),
                plain(error.contour_mm, 3),
                plain(s.tip_path.measured.noise_mm, 3),
                plain(error.max_mm, 3),
                listed(error.periods_mm, 3),
                plain(s.tip_plans.solve_p99_ms, 1) if s.tip_plans else "",
            )
        )
    heads = (
        "run",
        "controller",
        "learned from",
        "rms<br>[mm]",
        "lag<br>[mm]",
        "across the path<br>[mm]",
        "noise, measured<br>[mm]",
        "largest<br>[mm]",
        "rms of each period<br>[mm]",
        "solver p99<br>[ms]",
    )
    table = html_table(heads, rows, words=3)
    title = "<h2>Tip to reference</h2>"
    caption = "<p class=small>Of the true tip where a run was simulated, else of the measured one; without lead-in.</p>"
    return f"{title}\n{table}\n{caption}\n" if table else ""


def _marked(simulated: bool) -> str:
    return " (simulated)" if simulated else ""


def _check_mark(yes: bool) -> str:
    return "\N{HEAVY CHECK MARK}" if yes else "\N{MULTIPLICATION X}"


def table(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the errors of each run."""
    differ = len({tuple(map(str, run.header.protocol_parameters)) for run in runs}) > 1
    words = ["run", "model", "status", *(["parameters"] if differ else [])]
    numbers = (
        "mean error<br>[mm]",
        "settled<br>[mm]",
        "normalised<br>[%]",
        "rms x, y, z<br>[mm]",
        "largest<br>[mm]",
        "measured<br>[%]",
    )
    rows = [_row(run, summary, differ) for run, summary in zip(runs, summaries, strict=True)]
    return html_table((*words, *numbers), rows, words=len(words)) + "\n"


def _row(run: Run, s: Summary, parameters: bool) -> Sequence[str]:
    header = run.header
    words = [f"{escape(header.run_id)}{_marked(s.simulated)}", escape(header.model_variant), escape(s.status)]
    if parameters:
        words.append(escape(", ".join(map(str, header.protocol_parameters))))
    return (
        *words,
        plain(s.error_mm.mean, 2),
        plain(s.settled_error_mm, 2),
        plain(s.normalised_percent, 2),
        three(s.rmse_mm, 2),
        plain(s.error_mm.max, 2),
        plain(100 * s.measured_fraction, 1),
    )


def tips(figure: Figure, runs: Sequence[Run], summaries: Sequence[Summary]) -> None:
    """Measured and modelled tips of every run."""
    names = set()
    for axes, k, line in overlay.lines(figure, runs, range(len(runs))):
        run, summary = runs[k], summaries[k]
        project, name = across(run, summary)
        names.add(name)
        tip, _ = tip_with_gaps(run.tip)
        measured, model = (points[path_indices(points)] for points in (tip.measured_mm, tip.model_mm))
        if summary.frames_measured:
            axes.plot(*project(measured).T, **line, label=run.header.run_id)
        else:
            axes.plot([], [], **line, label=run.header.run_id)
        axes.plot(*project(model).T, **line | {"ls": ":"})
    for axes in overlay.align(figure):
        axes.set_aspect("equal", adjustable="datalim")
        axes.invert_yaxis()
        axes.set_ylabel("z, along the arm [mm]")
        legend(axes, columns=2)
    figure.axes[-1].set_xlabel(f"{' / '.join(sorted(names))} [mm]")


def errors(figure: Figure, runs: Sequence[Run], summaries: Sequence[Summary]) -> None:
    """Error of every run over protocol time, so that runs that waited differently still lie on one another."""
    for axes, k, line in overlay.lines(figure, runs, range(len(runs))):
        if summaries[k].frames_measured:
            tip, _ = tip_with_gaps(runs[k].tip)
            axes.plot(*decimated(tip.protocol_s, tip.error_mm), **line, label=runs[k].header.run_id)
    overlay.over_time(figure, "error [mm]")


def reference_distances(figure: Figure, runs: Sequence[Run], summaries: Sequence[Summary]) -> None:
    """Distance of every run's tip from its reference over protocol time."""
    for axes, k, line in overlay.lines(figure, runs, _on_a_path(runs)):
        header = runs[k].header
        learned = f", learned from {len(header.learned_from)}" if header.learned_from else ""
        label = f"{header.run_id} ({header.tip_controller}{learned})"
        axes.plot(*decimated(*distance_mm(runs[k])), **line, label=label)
    overlay.over_time(figure, "distance [mm]")


def _on_a_path(runs: Sequence[Run]) -> list[int]:
    """Return the indices of the runs whose tip has a reference."""
    return [k for k, run in enumerate(runs) if run.reference is not None]
