"""Several runs compared: the tables of their errors and settings, and their tips and errors overlaid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from html import escape

from matplotlib.figure import Figure

from runs.records import Status
from runs.report import differences, html, overlay, repeats
from runs.report.drawing import FigureSpecification, decimated, drawn, legend, path_indices
from runs.report.figures import across
from runs.report.further_figures import distance_mm
from runs.report.gaps import tip_with_gaps
from runs.report.html import html_table, listed, plain, three
from runs.report.overlay import ended, named
from runs.run import Run
from runs.summary import Summary


def section(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the part of a report that compares its runs."""
    simulated = any(summary.simulated for summary in summaries)
    early = [escape(f"{run.header.run_id}{ended(run)}") for run in runs if run.status is not Status.FINISHED]
    mark = "simulated" * simulated
    figures = drawn(
        [partial(html.figure, one, f"compared-{one.name}", mark) for one in comparison_figures(runs, summaries)]
    )
    papers = f'<div class="beside">{by_model(runs, summaries)}{by_axis(runs, summaries)}</div>'
    note = "<b>Simulated</b> runs are marked; nothing in them was measured on a real manipulator."
    left_out = f"<b>Not finished:</b> {', '.join(early)}. Such runs are marked in every table and count in no mean."
    parts = (
        html.heading(f"{len(runs)} runs", "", simulated=all(summary.simulated for summary in summaries)),
        html.note(note) if simulated else "",
        html.note(left_out, "fault") if early else "",
        f'<p class="conclusion">{conclusion(runs, summaries)}</p>',
        table(runs, summaries),
        by_controller(runs, summaries),
        html.figures(figures),
        repeats.section(runs),
        html.folded("Errors in the form of the paper's tables", papers),
        html.folded("Differing settings", differences.table(runs)),
        html.small("<code>rig report RUN</code> writes the whole report of one run."),
    )
    return "\n".join(('<section class="run">', *filter(None, parts), "</section>"))


def conclusion(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return in a few sentences what came out: only finished runs are ranked."""
    errors = {
        run.header.run_id: summary.error_mm.mean
        for run, summary in zip(runs, summaries, strict=True)
        if run.status is Status.FINISHED and math.isfinite(summary.error_mm.mean)
    }
    said = f"{sum(run.status is Status.FINISHED for run in runs)} of {len(runs)} runs finished."
    if len(errors) < 2:
        return said
    near, far = (choose(errors, key=errors.__getitem__) for choose in (min, max))
    return (
        f"{said} Of these, the measured tip lay nearest to the model in {escape(near)} ({plain(errors[near], 2)} mm on "
        f"average) and farthest in {escape(far)} ({plain(errors[far], 2)} mm)."
    )


def comparison_figures(runs: Sequence[Run], summaries: Sequence[Summary]) -> tuple[FigureSpecification, ...]:
    """Return the figures that compare runs."""
    size, beneath = overlay.size(len(runs), 2.4), overlay.caption(len(runs))
    where = "Each in its plane of motion, or over x where it keeps to none."
    found = (
        FigureSpecification("tips", "Tips", tips, size, f"Lines: measured. Dotted: model. {where}{beneath}"),
        FigureSpecification(
            "errors", "Errors over the protocol", errors, overlay.size(len(runs), 1.9), f"Measured to model.{beneath}"
        ),
        *_reference_distances(runs),
        *_tip_differences(runs),
    )
    return tuple(replace(figure, about=(runs, summaries)) for figure in found)


def _reference_distances(runs: Sequence[Run]) -> Iterator[FigureSpecification]:
    """Yield the figure of the tips' distances from their references, if more than one run follows a path."""
    if (count := len(_on_a_path(runs))) > 1:
        caption = f"Of the true tip where a run was simulated, else of the measured one.{overlay.caption(count)}"
        title, size = "Distance from the reference", overlay.size(count, 1.9)
        yield FigureSpecification("reference", title, reference_distances, size, caption)


def _tip_differences(runs: Sequence[Run]) -> Iterator[FigureSpecification]:
    """Yield the figure of the distances between tips of equal steps, if each of these runs has measured one."""
    equal = differences.of_equal_steps(runs)
    if len(equal) > 1 and len(differences.tips_at_equal_times(equal)[0]):
        others = len(equal) - 1
        caption = (
            f"From the tip of {escape(runs[0].header.run_id)}: measured tips at equal protocol times, interpolated "
            "between frames; no line in gaps of the frames."
        )
        caption += overlay.caption(others)
        if len(equal) < len(runs):
            caption += " Runs with other steps are left out."
        title = "Distance between the tips"
        yield FigureSpecification("differences", title, differences.draw, overlay.size(others, 1.9), caption)


def by_model(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the mean normalised error of each model in the shape of the paper's Table 3; nothing without one.

    What was simulated has rows of its own: no mean is over both.
    """
    known: dict[tuple[str, bool], list[float]] = {}
    for run, summary in zip(runs, summaries, strict=True):
        if math.isfinite(summary.normalised_percent) and run.status is Status.FINISHED:
            known.setdefault((run.header.model_variant, summary.simulated), []).append(summary.normalised_percent)
    rows = [
        (
            _check_mark(model.startswith("inhomogeneous")),
            _check_mark(model.endswith("+rpe")),
            plain(sum(errors) / len(errors), 2),
            f"{len(errors)}{' (simulated)' * simulated}",
        )
        for (model, simulated), errors in sorted(known.items())
    ]
    table = html_table(("inhomogeneity", "radial pressure effect", "|error| [%]", "runs"), rows, words=2)
    title = "<h2>Normalised error by model</h2>"
    caption = "<p class=small>As the paper's Table 3: the mean over the settled steps of the finished runs.</p>"
    return f"<div>{title}\n{table}{caption}</div>" if table else ""


def by_axis(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the rms errors of each run as the paper's Table 5, with y; nothing where nothing was measured.

    A case is its protocol, as in the paper; where several runs had the same one and the same model, the run.
    """
    cases = Counter((run.header.protocol_name, run.header.model_variant) for run in runs)
    alike = max(cases.values(), default=0) > 1
    rows = [
        (
            escape(named(run, None if alike else run.header.protocol_name)),
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
                escape(named(run)),
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
        "rms distance<br>[mm]",
        "of delay, rms<br>[mm]",
        "from the path, rms<br>[mm]",
        "measurement noise<br>[mm]",
        "largest distance<br>[mm]",
        "rms of each period<br>[mm]",
        "99 % of solutions<br>below [ms]",
    )
    table = html_table(heads, rows, words=3)
    title = "<h2>Tip to reference</h2>"
    caption = "<p class=small>Of the true tip where a run was simulated, else of the measured one; without lead-in.</p>"
    return f"{title}\n{table}\n{caption}\n" if table else ""


def _check_mark(yes: bool) -> str:
    return "\N{HEAVY CHECK MARK}" if yes else "\N{MULTIPLICATION X}"


def table(runs: Sequence[Run], summaries: Sequence[Summary]) -> str:
    """Return the errors of each run."""
    differ = len({tuple(map(str, run.header.protocol_parameters)) for run in runs}) > 1
    words = ["run", "model", "status", *(["parameters"] if differ else [])]
    numbers = (
        "mean error<br>[mm]",
        "settled error<br>[mm]",
        "normalised error<br>[%]",
        "rms error x, y, z<br>[mm]",
        "largest error<br>[mm]",
        "frames measured<br>[%]",
    )
    rows = [_row(run, summary, differ) for run, summary in zip(runs, summaries, strict=True)]
    return html_table((*words, *numbers), rows, words=len(words)) + "\n"


def _row(run: Run, s: Summary, parameters: bool) -> Sequence[str]:
    header = run.header
    words = [escape(named(run)), escape(header.model_variant), escape(s.status)]
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
        label = run.header.run_id + ended(run)
        if summary.frames_measured:
            axes.plot(*project(measured).T, **line, label=label)
        else:
            axes.plot([], [], **line, label=label)
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
            axes.plot(*decimated(tip.protocol_s, tip.error_mm), **line, label=runs[k].header.run_id + ended(runs[k]))
    overlay.over_time(figure, "error [mm]")


def reference_distances(figure: Figure, runs: Sequence[Run], summaries: Sequence[Summary]) -> None:
    """Distance of every run's tip from its reference over protocol time."""
    for axes, k, line in overlay.lines(figure, runs, _on_a_path(runs)):
        header = runs[k].header
        learned = f", learned from {len(header.learned_from)}" if header.learned_from else ""
        label = f"{header.run_id} ({header.tip_controller}{learned}){ended(runs[k])}"
        axes.plot(*decimated(*distance_mm(runs[k])), **line, label=label)
    overlay.over_time(figure, "distance [mm]")


def _on_a_path(runs: Sequence[Run]) -> list[int]:
    """Return the indices of the runs whose tip has a reference."""
    return [k for k, run in enumerate(runs) if run.reference is not None]
