"""The report: one HTML file that holds everything it shows, for one run or several."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from functools import partial
from html import escape
from pathlib import Path

from runs import annotation_file, arguments
from runs.archive import layout
from runs.overwriting import refuse_existing, write_text
from runs.report import comparison, html, pictures
from runs.report.drawing import drawn
from runs.report.figure_specifications import LEADING, figure_specifications
from runs.report.html import DASH, html_document, html_table, listed, plain, significant, three, with_unit
from runs.run import Run, paths_of
from runs.summary import BAND_BAR, Summary, summarise
from runs.tip_error import TipError, TipErrorSummary

SUFFIX = ".html"
_HEAD_BYTES = 100_000


def write(
    archives: Run | Path | str | Sequence[Run | Path | str],
    out_html: Path | str | None = None,
    *,
    replace: bool = False,
) -> Path:
    """Write the report of one run or several and return its path; by default `default_path`.

    Runs are given as `Run`, path, run id or `last`. An earlier report of the same runs is written again.

    Raises:
        ArchiveError: a run is not found.
        ArgumentError: there is no run, or `out_html` is no path.
        WouldOverwriteError: there is another file, and `replace` is False.
        OSError: it cannot be written.
    """
    chosen = paths_of([archives] if isinstance(archives, Run | str | os.PathLike) else archives)
    if not chosen:
        raise arguments.refused("archives", archives, "at least one run")
    target = default_path(chosen) if out_html is None else arguments.path("out_html", out_html)
    runs = [Run(path) for path in chosen]
    mark = _mark(runs)
    refuse_existing([target], replace=replace, made=lambda file: mark in _head(file))
    write_text(target, page(runs))
    return target


def default_path(archives: Sequence[Path], suffix: str = SUFFIX) -> Path:
    """Beside the first archive: the name of the run, or of a comparison, after both runs or the first and a number."""
    first, *others = archives
    name = first.stem
    if len(others) == 1:
        name += f"-and-{others[0].stem}"
    elif others:
        name += f"-and-{len(others)}-others"
    return first.with_name(name + suffix)


def _mark(runs: Sequence[Run]) -> str:
    """Return the element that marks a file as the report of these runs."""
    return f'<meta name="softrig-report" content="{escape(" ".join(run.header.run_id for run in runs))}">'


def _head(file: Path) -> str:
    try:
        with file.open("rb") as opened:
            return opened.read(_HEAD_BYTES).decode("utf-8", errors="replace")
    except OSError:
        return ""


def page(runs: Sequence[Run]) -> str:
    """Return the whole HTML text."""
    title = escape(runs[0].header.title if len(runs) == 1 else f"{len(runs)} runs")
    summaries = [summarise(run) for run in runs]
    body = comparison.section(runs, summaries) if len(runs) > 1 else _run(runs[0], summaries[0])
    return html_document(title, _mark(runs), body)


def _run(run: Run, summary: Summary) -> str:
    leading, further = _figures(run, summary)
    parts = (
        _heading(run, summary),
        *_notes(run, summary),
        f'<p class="conclusion">{conclusion(summary)}</p>',
        html.tiles(leading_numbers(summary)),
        html.figures(leading),
        html.folded("Further figures", html.figures(further)),
        html.folded("All numbers", html_table((), all_numbers(summary), kind="facts")),
        html.folded("Segments", _steps(summary)),
        html.folded("Periodic motion", _periodic(summary)),
        html.folded("Camera pictures", pictures.section(run, summary)),
        html.folded("Events", _events(run)),
        html.folded("How it was made", _provenance(run)),
        html.folded("Numbers that were used", _quantities(run)),
        *_inputs(run),
    )
    return "\n".join(('<section class="run">', *filter(None, parts), "</section>"))


def _heading(run: Run, summary: Summary) -> str:
    header = run.header
    tags = "".join(f'<span class="badge">{escape(tag)}</span>' for tag in annotation_file.read(run.path).tags)
    began = layout.utc(header.started_utc_ns)[:19].replace("T", " ")
    facts = (header.run_id, f"{began} UTC", f"{run.duration_s:.1f} s", header.executor, header.operator)
    badges = f'<span class="badge {summary.status}">{summary.status}</span>{tags}'
    beneath = " · ".join(escape(fact) for fact in facts if fact)
    return html.heading(escape(header.title), beneath, simulated=summary.simulated, badges=badges)


def _notes(run: Run, summary: Summary) -> Iterator[str]:
    if summary.message:
        yield html.note(f"<b>{escape(str(summary.status))}:</b> {escape(summary.message)}", "fault")
    if summary.simulated:
        yield html.note(
            "<b>This run was simulated.</b> Card, camera or arm were those of the simulator; "
            "nothing here was measured on a real manipulator."
        )
    if not summary.camera:
        yield html.note(
            "The rig has no camera, so the tip was not measured: the report shows the pressures and the model alone."
        )
    elif summary.frames and not summary.frames_measured:
        yield html.note("No tip was measured in this run: what is shown of it is the model alone.")
    if run.header.notes:
        yield f"<p>{escape(run.header.notes)}</p>"
    for added in annotation_file.read(run.path).notes:
        yield f"<p>{escape(added.time)}: {escape(added.text)}</p>"


def conclusion(s: Summary) -> str:
    """Return in a few sentences what came out of a run."""
    said = []
    if s.tip_path is not None:
        whose, error = _tip_to_reference(s.tip_path)
        if math.isfinite(error.rms_mm):
            said.append(
                f"The {whose} tip kept to its reference within {plain(error.rms_mm, 3)} mm rms, "
                f"at most {plain(error.max_mm, 3)} mm away."
            )
    if math.isfinite(s.error_mm.mean):
        share = f", {plain(s.normalised_percent, 1)} % of its distance from rest" * math.isfinite(s.normalised_percent)
        settled = (
            f" and in the settled steps {plain(s.settled_error_mm, 2)} mm{share}" if s.settled_error_mm > 0 else ""
        )
        said.append(
            f"The measured tip lay {plain(s.error_mm.mean, 2)} mm from the model on average{settled}; the largest "
            f"distance was {plain(s.error_mm.max, 2)} mm."
        )
    if s.camera and s.frames_expected:
        said.append(f"The tip was measured in {s.frames_measured} of {s.frames_expected} frames.")
    if s.lateness_max_us > 0:
        missed = f"{s.missed_deadlines} of {s.cycles} control deadlines were missed."
        said.append(missed if s.missed_deadlines else "No control deadline was missed.")
    return " ".join(said) or f"{s.cycles} control cycles were recorded."


def _tip_to_reference(path: TipErrorSummary) -> tuple[str, TipError]:
    """Return whose tip is compared with its reference, the true one where it is known, and its error."""
    return ("measured", path.measured) if path.truth is None else ("simulated true", path.truth)


def leading_numbers(s: Summary) -> list[tuple[str, str]]:
    """Return the numbers that most readers want, each with a name that stands alone; at most four are known."""
    numbers = []
    if s.tip_path is not None:
        whose, error = _tip_to_reference(s.tip_path)
        numbers.append((with_unit(error.rms_mm, "mm", 3), f"rms distance of the {whose} tip from its reference"))
    numbers += [
        (with_unit(s.error_mm.mean, "mm", 2), "mean distance of the measured tip from the model"),
        (with_unit(s.error_mm.max, "mm", 2), "largest distance of the measured tip from the model"),
        (with_unit(s.normalised_percent, "%", 1), "settled error over the distance of the tip from rest"),
        (with_unit(100 * s.measured_fraction, "%", 1) if s.camera else DASH, "expected frames with a measured tip"),
        (with_unit(s.tracking_rms_bar * 1e3, "mbar", 1), "rms distance of moving pressures from their set-points"),
    ]
    return [number for number in numbers if DASH not in number[0]][:4]


def all_numbers(s: Summary) -> list[tuple[str, str]]:
    """Return every number of a run that is known, by its name."""
    in_plane = "in the plane of motion"
    numbers = [
        ("mean distance of the measured tip from the model (3-D)", with_unit(s.error_mm.mean, "mm", 2)),
        (f"mean distance of the measured tip from the model, {in_plane}", with_unit(s.in_plane_mm.mean, "mm", 2)),
        ("largest distance of the measured tip from the model", with_unit(s.error_mm.max, "mm", 2)),
        *(
            (f"rms difference of measured and modelled tip in {axis}", with_unit(rmse, "mm", 2))
            for axis, rmse in zip("xyz", s.rmse_mm, strict=True)
        ),
        ("mean distance of the settled tip from the model", with_unit(s.settled_error_mm, "mm", 2)),
        ("mean settled error over the distance of the tip from rest", with_unit(s.normalised_percent, "%", 2)),
        (f"longest settling of a pressure within {BAND_BAR * 1e3:.0f} mbar", with_unit(s.settling_s, "s", 2)),
        ("largest overshoot of a pressure", with_unit(s.overshoot_bar * 1e3, "mbar", 1)),
        ("rms distance of moving pressures from their set-points", with_unit(s.tracking_rms_bar * 1e3, "mbar", 1)),
        ("control deadlines missed", f"{s.missed_deadlines} of {s.cycles}" if s.lateness_max_us else DASH),
        ("lateness that 99 % of the control cycles stay below", with_unit(s.lateness_p99_us or math.nan, "us", 1)),
        (
            "frames with a measured tip",
            f"{s.frames_measured} of {s.frames_expected} expected; {s.frames_dropped} dropped" if s.camera else DASH,
        ),
        ("frames with a measured orientation of the tip", str(s.frames_oriented) if s.frames_oriented else DASH),
        (
            "standard uncertainty of the tip's orientation about an axis",
            with_unit(s.orientation_std_deg, "deg", 3) if s.frames_oriented else DASH,
        ),
    ]
    if s.truth is not None:
        from_truth = "distance of the measured tip from the simulated true tip"
        numbers += [
            (f"mean {from_truth}", with_unit(s.truth.error_mm.mean, "mm", 3)),
            (f"mean {from_truth}, {in_plane}", with_unit(s.truth.in_plane_mm.mean, "mm", 3)),
            ("frames whose true tip lies in the stated 95 %", with_unit(100 * s.truth.coverage, "%", 1)),
        ]
    if s.tip_path is not None:
        whose, error = _tip_to_reference(s.tip_path)
        numbers += [
            (f"rms distance of the {whose} tip from its reference", with_unit(error.rms_mm, "mm", 3)),
            (f"largest distance of the {whose} tip from its reference", with_unit(error.max_mm, "mm", 3)),
            (f"delay of the {whose} tip behind its reference", with_unit(error.lag_ms, "ms", 1)),
            (f"rms distance of the {whose} tip from its reference due to delay", with_unit(error.lag_mm, "mm", 3)),
            (f"rms distance of the {whose} tip from its path (contour error)", with_unit(error.contour_mm, "mm", 3)),
            ("rms noise of the measured tip", with_unit(s.tip_path.measured.noise_mm, "mm", 3)),
        ]
    if s.tip_plans is not None:
        without = 100 * s.tip_plans.without_feedback
        numbers.append(("share of the tip path that ran without feedback", with_unit(without, "%", 1)))
        solved = with_unit(s.tip_plans.solve_p99_ms, "ms", 1)
        numbers.append(("time that 99 % of the tip controller's solutions stay below", solved))
    return [number for number in numbers if DASH not in number[1]]


def _figures(run: Run, summary: Summary) -> tuple[list[str], list[str]]:
    """Return the leading figures, and the others."""
    specifications = list(figure_specifications(run, summary))
    mark = "simulated" * summary.simulated
    figures = [partial(html.figure, one, f"{run.header.run_id}-{one.name}", mark) for one in specifications]
    shown = drawn(figures)
    further = shown[LEADING:]
    if run.header.executor == "virtual time" and summary.cycles and not summary.lateness_max_us:
        further.append(html.small("Timing of the control loop: not in real time, no control cycle is late."))
    return shown[:LEADING], further


def _steps(summary: Summary) -> str:
    """Return the table of the segments, without the columns that would say nothing."""
    columns: dict[str, list[str]] = {
        "weight<br>[g]": [plain(s.weight_g, 0) if s.weight_g > 0 else "" for s in summary.steps],
        "set-points<br>[bar]": ["&ensp;".join(plain(level, 2) for level in s.level_bar) for s in summary.steps],
        "measured x, y, z<br>[mm]": [three(s.measured_mm, 1) if s.dwell else "" for s in summary.steps],
        "model x, y, z<br>[mm]": [three(s.model_mm, 1) if s.dwell else "" for s in summary.steps],
        "error<br>[mm]": [plain(s.error_mm, 2) for s in summary.steps],
        "in plane<br>[mm]": [plain(s.in_plane_mm, 2) for s in summary.steps],
        "normalised<br>[%]": [plain(s.normalised_percent, 2) if s.dwell else "" for s in summary.steps],
        "settling<br>[s]": [plain(s.settling_s, 2) if s.dwell else "" for s in summary.steps],
        "overshoot<br>[mbar]": [plain(s.overshoot_bar * 1e3, 1) if s.dwell else "" for s in summary.steps],
        "tracking rms<br>[mbar]": [plain(s.tracking_rms_bar * 1e3, 1) for s in summary.steps],
    }
    shown = {name: cells for name, cells in columns.items() if any(cell not in ("", DASH) for cell in cells)}
    if not summary.steps:
        return ""
    rows = [(escape(step.label), *(cells[i] for cells in shown.values())) for i, step in enumerate(summary.steps)]
    note = (
        "<p class=small>Set-points: at the end of the segment. Tips and errors of dwells: mean over their last part; "
        "of other segments: mean over the whole.</p>"
    )
    return f"{html_table(('segment', *shown), rows, words=1)}\n{note}"


def _periodic(summary: Summary) -> str:
    """Return the table of the periodic segments."""
    heads = (
        "segment",
        "period<br>[s]",
        "pressure:<br>ratio",
        "lag<br>[ms]",
        "tip:<br>amplitude [mm]",
        "lag<br>[ms]",
        "loop<br>[%]",
        "model:<br>ratio",
        "lag<br>[ms]",
        "loop<br>[%]",
        "mean error of each period<br>[mm]",
    )
    rows = [
        (
            escape(motion.label),
            plain(motion.period_s, 3),
            plain(motion.pressure_ratio, 3),
            plain(motion.pressure_lag_ms, 1),
            plain(motion.tip_amplitude_mm, 2),
            plain(motion.tip_lag_ms, 1),
            plain(motion.tip_loop_percent, 1),
            plain(motion.model_ratio, 3),
            plain(motion.model_lag_ms, 1),
            plain(motion.model_loop_percent, 1),
            listed(motion.error_mm, 2),
        )
        for motion in summary.periodic
    ]
    note = (
        "<p class=small>Fundamental of the motion over whole periods. Lags count from the set-point. Ratios: measured "
        "pressure to set-point; modelled to measured tip. Loop: area that tip and measured pressure enclose in a "
        "period, in percent of the rectangle around it: hysteresis and delay together. "
        "A tip that goes round has neither lag nor loop.</p>"
    )
    return f"{html_table(heads, rows, words=1)}\n{note}" if rows else ""


def _events(run: Run) -> str:
    start = run.header.started_t_ns
    rows = [
        (
            f"{(e.t_ns - start) / 1e9:.3f}",
            f'<span class="{e.level}">{e.level}</span>',
            escape(e.source),
            escape(e.message),
        )
        for e in run.events
    ]
    return html_table(("time [s]", "level", "source", "message"), rows)


def _provenance(run: Run) -> str:
    header = run.header
    commit = header.git_commit + (", with changes that were not committed" if header.git_diff else "")
    facts = {
        "run": header.run_id,
        "protocol": header.protocol_name,
        "parameters": ", ".join(map(str, header.protocol_parameters)),
        "rig": header.rig_name,
        "model": header.model_variant,
        "executor": header.executor + (f", seed {header.seed}" if header.seed is not None else ""),
        "operator": header.operator,
        "metadata": ", ".join(f"{name} = {text}" for name, text in header.metadata.items()),
        "command": header.command,
        "host": header.host,
        "versions": ", ".join(f"{name} {version}" for name, version in sorted(header.versions.items())),
        "git": commit if header.git_commit else "",
        "archive": run.path.name,
        "SHA-256": run.sha256,
        "counted": ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in run.timing.counters.items()),
    }
    return html_table((), [(name, escape(value)) for name, value in facts.items() if value], kind="facts")


def _inputs(run: Run) -> Iterator[str]:
    """Yield the texts that a run was made of, each folded."""
    for name, text in (run.header.inputs | {"git diff": run.header.git_diff}).items():
        if text:
            yield html.folded(f"{escape(name[:1].upper() + name[1:])}, verbatim", f"<pre>{escape(text)}</pre>")


def _quantities(run: Run) -> str:
    rows = [
        [*map(escape, (q.room, q.name, _listed(q.value), q.unit, significant(q.uncertainty, 3), q.source))]
        for q in run.header.quantities
    ]
    return html_table(("of", "name", "value", "unit", "standard uncertainty", "source"), rows)


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)
