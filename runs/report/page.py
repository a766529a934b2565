"""The report: one HTML file that holds everything it shows, for one run or several."""

from __future__ import annotations

import math
import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from html import escape
from importlib import resources
from itertools import zip_longest
from multiprocessing.connection import Connection
from pathlib import Path

from runs import annotation_file, arguments
from runs.archive import layout
from runs.overwriting import refuse_existing, write_text
from runs.printable_text import printable
from runs.report import comparison, pictures
from runs.report.drawing import svg
from runs.report.figure_specifications import figure_specifications
from runs.report.html_table import DASH, html_table, listed, plain, significant, three, with_unit
from runs.run import Run, paths_of
from runs.summary import BAND_BAR, Summary, summarise

SUFFIX = ".html"
_HEAD_BYTES = 100_000
Draw = Callable[[], str]


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


def html_document(title: str, head: str, body: str) -> str:
    """Return an HTML page in the style of the reports; `head` is put into its head, all arguments are HTML.

    Control characters and marks of direction, as a title may hold, are shown as their escapes.
    """
    style = resources.files("runs.report").joinpath("report.css").read_text(encoding="utf-8")
    return printable(
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n{head}\n<title>{title}</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>\n{style}</style>\n</head>\n'
        f"<body>\n{body}\n<footer>Made by softrig; nothing in this page is loaded from elsewhere."
        "</footer>\n</body>\n</html>\n"
    )


def _run(run: Run, summary: Summary) -> str:
    header = run.header
    badges = f'<span class="badge {summary.status}">{summary.status}</span>'
    if summary.simulated:
        badges += '<span class="badge simulated">simulated</span>'
    added = annotation_file.read(run.path)
    badges += "".join(f'<span class="badge">{escape(tag)}</span>' for tag in added.tags)
    began = layout.utc(header.started_utc_ns)[:19].replace("T", " ")
    parts = [
        f'<section class="run">\n<header class="run"><h1>{escape(header.title)}{badges}</h1>\n'
        f'<p class="sub">{escape(header.run_id)} · {began} UTC · {run.duration_s:.1f} s · {escape(header.executor)}'
        f"{' · ' + escape(header.operator) if header.operator else ''}</p></header>",
    ]
    if summary.simulated:
        parts.append(
            '<p class="note"><b>This run was simulated.</b> Card, camera or arm were those of the simulator; '
            "nothing here was measured on a real manipulator.</p>"
        )
    if not summary.camera:
        parts.append(
            '<p class="note">The rig has no camera, so the tip was not measured: the report shows the pressures and '
            "the model alone.</p>"
        )
    elif summary.frames and not summary.frames_measured:
        parts.append('<p class="note">No tip was measured in this run: what is shown of it is the model alone.</p>')
    if summary.message:
        parts.append(f'<p class="note fault"><b>{escape(str(summary.status))}:</b> {escape(summary.message)}</p>')
    if header.notes:
        parts.append(f"<p>{escape(header.notes)}</p>")
    parts += [f"<p>{escape(note.time)}: {escape(note.text)}</p>" for note in added.notes]
    parts += [
        _tiles(summary),
        *_figures(run, summary),
        _steps(summary),
        _periodic(summary),
        pictures.section(run, summary),
        _events(run),
    ]
    parts += [_provenance(run), "</section>"]
    return "\n".join(part for part in parts if part)


def _tiles(s: Summary) -> str:
    tiles = [
        (with_unit(s.error_mm.mean, "mm", 2), "mean error, measured to model (3-D)"),
        (with_unit(s.in_plane_mm.mean, "mm", 2), "mean error in the plane of motion"),
        *((with_unit(rmse, "mm", 2), f"rms error in {axis}") for axis, rmse in zip("xyz", s.rmse_mm, strict=True)),
        (with_unit(s.settled_error_mm, "mm", 2), "mean settled error of the steps"),
        (with_unit(s.settling_s, "s", 2), f"longest settling within {BAND_BAR * 1e3:.0f} mbar"),
        (with_unit(s.overshoot_bar * 1e3, "mbar", 1), "largest overshoot"),
        (with_unit(s.tracking_rms_bar * 1e3, "mbar", 1), "rms tracking, moving set-points"),
        (
            f"{s.missed_deadlines} <small>of {s.cycles}</small>" if s.lateness_max_us else DASH,
            "control deadlines missed",
        ),
        (with_unit(s.lateness_p99_us or math.nan, "us", 1), "lateness, 99 % of the control cycles below"),
        (
            with_unit(100 * s.measured_fraction, "%", 1) if s.camera else DASH,
            f"frames measured of {s.frames_expected} expected; {s.frames_dropped} dropped",
        ),
    ]
    if s.frames_oriented:
        about = f"standard uncertainty of the tip's orientation about an axis, in {s.frames_oriented} frames"
        tiles.append((with_unit(s.orientation_std_deg, "deg", 3), about))
    if s.truth is not None:
        tiles += [
            (with_unit(s.truth.error_mm.mean, "mm", 3), "mean measured to simulated truth"),
            (with_unit(s.truth.in_plane_mm.mean, "mm", 3), "the same in the plane of motion"),
            (with_unit(100 * s.truth.coverage, "%", 1), "frames whose truth lies in the stated 95 %"),
        ]
    if s.tip_path is not None:
        error, label = s.tip_path.measured, "measured tip to reference, rms"
        if s.tip_path.truth is not None:
            error, label = s.tip_path.truth, "simulated true tip to reference, rms"
        tiles += [
            (with_unit(error.rms_mm, "mm", 3), label),
            (with_unit(error.lag_ms, "ms", 1), f"of it lag, {plain(error.lag_mm, 3)} mm"),
            (with_unit(error.contour_mm, "mm", 3), "of it across the path"),
            (with_unit(s.tip_path.measured.noise_mm, "mm", 3), "noise of the measured tip"),
        ]
    if s.tip_plans is not None:
        tiles.append((with_unit(100 * s.tip_plans.without_feedback, "%", 1), "of the tip path without feedback"))
        tiles.append((with_unit(s.tip_plans.solve_p99_ms, "ms", 1), "solver time of the tip controller, 99 % below"))
    shown = (
        f'<div class="tile"><b>{value}</b><span>{label}</span></div>' for value, label in tiles if DASH not in value
    )
    return f'<div class="tiles">{"".join(shown)}</div>'


def _figures(run: Run, summary: Summary) -> Iterator[str]:
    salt = run.header.run_id
    figures = list(figure_specifications(run, summary))
    drawings = drawn([partial(svg, figure.draw, figure.size, salt, run, summary) for figure in figures])
    for figure, drawing in zip(figures, drawings, strict=True):
        yield _figure(figure.title, drawing, figure.caption)
    if run.header.executor == "virtual time" and summary.cycles and not summary.lateness_max_us:
        yield "<h2>Timing of the control loop</h2>\n<p class=small>Not in real time: no control cycle is late.</p>"


def _figure(title: str, drawing: str, caption: str) -> str:
    below = f"<figcaption>{caption}</figcaption>" if caption else ""
    drawing = drawing.replace("<svg", f'<svg role="img" aria-label="{escape(title)}"', 1)
    return f"<h2>{title}</h2>\n<figure>{drawing}{below}</figure>"


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
    return f"<h2>Segments</h2>\n{html_table(('segment', *shown), rows, words=1)}\n{note}"


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
    return f"<h2>Periodic motion</h2>\n{html_table(heads, rows, words=1)}\n{note}" if rows else ""


def _events(run: Run) -> str:
    start = run.header.started_t_ns
    rows = "".join(
        f'<tr><td class=n>{(e.t_ns - start) / 1e9:.3f}</td><td class="{e.level}">{e.level}</td>'
        f"<td>{escape(e.source)}</td><td>{escape(e.message)}</td></tr>"
        for e in run.events
    )
    head = "<tr><th class=n>time [s]</th><th>level</th><th>source</th><th>message</th></tr>"
    return f"<h2>Events</h2>\n<table>{head}{rows}</table>" if rows else ""


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
    rows = "".join(f"<tr><th>{name}</th><td>{escape(value)}</td></tr>" for name, value in facts.items() if value)
    parts = [f'<h2>How it was made</h2>\n<table class="facts">{rows}</table>', _quantities(run)]
    for name, text in (header.inputs | {"git diff": header.git_diff}).items():
        if text:
            summary = escape(name[:1].upper() + name[1:])
            parts.append(f"<details><summary>{summary}, verbatim</summary><pre>{escape(text)}</pre></details>")
    return "\n".join(part for part in parts if part)


def _quantities(run: Run) -> str:
    rows = [
        [*map(escape, (q.room, q.name, _listed(q.value), q.unit, significant(q.uncertainty, 3), q.source))]
        for q in run.header.quantities
    ]
    table = html_table(("of", "name", "value", "unit", "standard uncertainty", "source"), rows)
    return f"<details><summary>Numbers that were used</summary>{table}</details>" if rows else ""


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


def drawn(figures: Sequence[Draw]) -> list[str]:
    """Return the results of functions that draw a figure, in their order; a second processor draws every other one.

    The child is forked, so that it has what the figures show. If it fails, this process draws its part, too, and
    raises the error.
    """
    # Windows cannot fork, and on macOS a forked process must not draw; neither has this function.
    if len(figures) < 2 or not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2:
        return [draw() for draw in figures]
    fork = multiprocessing.get_context("fork")
    received, sent = fork.Pipe(duplex=False)
    child = fork.Process(target=_draw, args=(figures[1::2], sent), daemon=True)
    with warnings.catch_warnings():
        # Python warns of every fork beside other threads; no figure waits for one.
        warnings.simplefilter("ignore", DeprecationWarning)
        child.start()
    sent.close()
    try:
        even, odd = [draw() for draw in figures[::2]], []
        with suppress(EOFError, OSError):
            odd = received.recv()
    finally:
        child.kill()
        child.join()
        received.close()
    odd = odd or [draw() for draw in figures[1::2]]
    return [drawing for pair in zip_longest(even, odd) for drawing in pair if drawing is not None]


def _draw(figures: Sequence[Draw], results: Connection) -> None:
    with suppress(Exception):
        results.send([draw() for draw in figures])
