"""Output of the archive commands."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer
from rich.console import Group
from rich.table import Table
from rich.text import Text

import runs as records
from protocols.problems import BadInputError, Problem, raise_all
from rig.cli.completion import DATA
from rig.cli.exit_status import FAULT
from rig.cli.output import ColumnTable, console, facts_table, print_json
from rig.cli.run_names import resolve
from runs import annotation_file
from runs.catalogue import Entry
from runs.pressure_cycles import pressure_cycles
from runs.records import Quantity, StudyRun
from runs.recovery import RecoveryStatus
from runs.recovery import recover as recover_folder
from runs.run import Run
from runs.summary import Summary, summarise
from runs.tip_error import TipErrorSummary
from runs.tip_plans import TipPlans, refusals

WARNINGS_SHOWN = 10
_DATE = re.compile(r"\d{4}(-(0[1-9]|1[0-2])(-(0[1-9]|[12]\d|3[01])(T([01]\d|2[0-3])(:[0-5]\d(:[0-5]\d)?)?)?)?)?")


def check_search(folder: Path, since: str = "", until: str = "") -> None:
    """Raise `BadInputError` for a filter that no archive can match; only the default folder may be missing."""
    problems = []
    if folder != DATA and not folder.is_dir():
        problems.append(Problem("DIR", 0, 0, "", str(folder), "a folder of archives: this folder does not exist"))
    for option, date in (("--since", since), ("--until", until)):
        if date and not _DATE.fullmatch(date):
            problems.append(Problem(option, 0, 0, "", date, "a date or its beginning, as 2026-11 or 2026-11-21T14:05"))
    raise_all(problems)


def show(name: Path, as_json: bool) -> None:
    """Print the provenance and the summary of an archive."""
    archive = resolve(name)
    run = records.open(archive)
    summary = summarise(run)
    added = annotation_file.read(archive)
    if as_json:
        whole = {"header": run.header, "summary": summary_facts(archive), "annotations": added}
        print_json(whole)
        return
    header = run.header
    screen = console()
    simulated = " (simulated)" if header.simulated else ""
    facts = (
        ("run", header.run_id + simulated),
        ("title", header.title),
        ("status", f"{summary.status} {summary.message}".strip()),
        *(("warning", text) for text in summary.warnings[:WARNINGS_SHOWN]),
        *_more_warnings(len(summary.warnings) - WARNINGS_SHOWN),
        ("executor", header.executor),
        ("protocol", header.protocol_name),
        ("parameters", ", ".join(map(str, header.protocol_parameters)) or "-"),
        ("rig", header.rig_name),
        ("tip measured by", _tip_source(run)),
        ("model", header.model_variant or "-"),
        *((("gravity", _gravity(header.measured_gravity)),) if header.measured_gravity else ()),
        ("study", _study(header.study)),
        ("operator", header.operator or "-"),
        ("metadata", ", ".join(f"{name} = {text}" for name, text in header.metadata.items()) or "-"),
        ("notes", header.notes or "-"),
        *(("note", f"{note.time}: {note.text}") for note in added.notes),
        ("tags", ", ".join(added.tags) or "-"),
        ("pressure cycles", str(pressure_cycles(run.pressure.measured_bar))),
        ("command", header.command),
        ("host", header.host),
        ("commit", (header.git_commit or "-") + (" with uncommitted changes" if header.git_diff else "")),
        ("versions", ", ".join(f"{name} {version}" for name, version in header.versions.items())),
    )
    screen.print(facts_table(facts))
    screen.print(summary_table(summary, run.timing.counters))


def _more_warnings(number: int) -> tuple[tuple[str, str], ...]:
    """Return the row that stands for warnings that are not shown."""
    return (("warning", f"and {number} more, in the report and with --json"),) if number > 0 else ()


def _gravity(quantity: Quantity) -> str:
    direction = ", ".join(f"{value:.3f}" for value in quantity.value)
    return (
        f"[{direction}] in the rod-base frame, +- {math.degrees(quantity.uncertainty):.1f} degrees ({quantity.source})"
    )


def _tip_source(run: Run) -> str:
    """Return what measured the tip: cameras with the board they look at, or a tracker."""
    from rig.config.loader import recorded

    if not run.header.rig_yaml:
        return "-"
    try:
        config = recorded(run.header, run.path).config
    except BadInputError:
        return "unknown: the rig was recorded by another version of softrig"
    if config.tracker is not None:
        return f"tracker {next(iter(config.trackers))}"
    if config.board is None or not config.cameras:
        return "-"
    kind = "camera" if len(config.cameras) == 1 else "cameras"
    return f"{kind} {', '.join(config.cameras)}: " + "; ".join((config.board.words, *config.board.marker_texts))


def _study(place: StudyRun | None) -> str:
    if place is None:
        return "-"
    return f"{place.study}, {place.role} {place.number}, combination {place.combination}, block {place.block}"


def summary_facts(archive: Path) -> dict[str, Any]:
    """Return a run's summary for JSON."""
    summary = summarise(records.open(archive))
    facts: dict[str, Any] = asdict(summary)
    if not summary.camera:
        # A count of frames would be a zero for what is not measured.
        facts |= dict.fromkeys(("frames", "frames_measured", "frames_dropped", "frames_expected"))
    return facts


def summary_table(summary: Summary, counters: Mapping[str, int]) -> Group:
    """Return a run's summary: one row per segment, then the whole run; `counters` are the executor's.

    A run in virtual time, a model run and an import have no deadlines, hence no rows about them.
    """
    numbers = ("error [mm]", "normalised [%]", "settled after [s]", "overshoot [bar]")
    steps = ColumnTable("segment", numbers=numbers)
    for step in summary.steps:
        steps.add_row(
            step.label or step.kind,
            _number(step.error_mm, 2),
            _number(step.normalised_percent, 2),
            _number(step.settling_s, 2),
            _number(step.overshoot_bar, 4),
        )
    # The names of the whole run are longer than those of segments: they have columns of their own.
    table = facts_table()
    simulated = " (simulated)" if summary.simulated else ""
    if summary.camera:
        table.add_row(
            Text(f"whole run{simulated}: mean error [mm]", "bold"), Text(_number(summary.error_mm.mean, 2), "bold")
        )
        table.add_row("largest error [mm]", _number(summary.error_mm.max, 2))
        table.add_row("frames measured", f"{summary.frames_measured} of {summary.frames_expected}")
        table.add_row("frames dropped", str(summary.frames_dropped))
    else:
        table.add_row(Text(f"whole run{simulated}: tip not measured, the rig has no camera", "bold"))
    if summary.frames_oriented:
        table.add_row("frames with an orientation of the tip", str(summary.frames_oriented))
        table.add_row("  standard uncertainty about an axis [deg]", f"{summary.orientation_std_deg:.2g}")
    if summary.tip_path is not None:
        _add_tip_path(table, summary.tip_path)
    if summary.tip_plans is not None:
        _add_tip_plans(table, summary.tip_plans)
    if summary.lateness_max_us > 0:
        table.add_row("deadlines missed", f"{summary.missed_deadlines} of {summary.cycles}")
        late = (summary.lateness_p50_us, summary.lateness_p99_us, summary.lateness_max_us)
        table.add_row("lateness p50/p99/max [us]", " / ".join(_number(us, 0) for us in late))
    if counters.get("damaged_lines"):
        table.add_row("damaged lines between computer and card", str(counters["damaged_lines"]))
    if "lost_setpoints" in counters:
        lost, refused = counters["lost_setpoints"], counters["refused_setpoints"]
        table.add_row("set-points of another program", f"{lost} lost, {refused} refused")
    if "stolen_cpu_ms" in counters:
        table.add_row("CPU time stolen by the host [ms]", str(counters["stolen_cpu_ms"]))
    for name, period_ns in counters.items():
        if (card := name.removesuffix("_scan_period_ns")) != name:
            drift_ppm = counters.get(f"{card}_scan_drift_ppb", 0) * 1e-3
            table.add_row(f"card {card} samples every [us]", f"{period_ns * 1e-3:.3f}")
            table.add_row("longer by the computer's clock [ppm]", f"{drift_ppm:+.1f}")
    return Group(*((steps,) if summary.steps else ()), table)


def _add_tip_path(table: Table, path: TipErrorSummary) -> None:
    errors = [("measured", path.measured)]
    if path.truth is not None:
        errors.append(("true, simulated", path.truth))
    for words, error in errors:
        if not error.frames:
            table.add_row(f"tip to reference ({words})", "no frame falls on the path")
            continue
        table.add_row(f"tip to reference, rms ({words}) [mm]", _number(error.rms_mm, 3))
        if not math.isnan(error.lag_ms):
            table.add_row(f"  lag of {error.lag_ms:.1f} ms [mm]", _number(error.lag_mm, 3))
        if not math.isnan(error.contour_mm):
            table.add_row("  across the path [mm]", _number(error.contour_mm, 3))
    for words, value in (
        ("noise of the measured tip", path.measured.noise_mm),
        ("predicted by the model", path.predicted_mm),
    ):
        if not math.isnan(value):
            table.add_row(f"  {words} [mm]", _number(value, 3))


def _add_tip_plans(table: Table, plans: TipPlans) -> None:
    counts = [str(plans.count)]
    if plans.not_solved:
        counts.append(f"{plans.not_solved} not solved")
    if plans.refused:
        counts.append(f"{sum(plans.refused.values())} refused: {refusals(plans.refused)}")
    table.add_row("plans of the tip controller", ", ".join(counts))
    table.add_row("  at a limit of pressure or rate", str(plans.constrained))
    if not math.isnan(plans.without_feedback):
        lost = f"{100 * plans.without_feedback:.1f} %"
        table.add_row("path without feedback", Text(lost, "bold red") if plans.without_feedback else lost)
    if not math.isnan(plans.solve_p99_ms):
        solve = (plans.solve_p50_ms, plans.solve_p99_ms, plans.solve_max_ms)
        table.add_row("  solver time p50/p99/max [ms]", " / ".join(_number(ms, 1) for ms in solve))


def _number(value: float, digits: int) -> str:
    """Format a number of a table: a dash for NaN, `never` for an infinite settling time."""
    return "-" if math.isnan(value) else "never" if math.isinf(value) else f"{value:.{digits}f}"


def recover(folder: Path) -> None:
    """Recover orphaned journals and print the outcome of each."""
    check_search(folder)
    outcomes = [o for o in recover_folder(folder) if o.status is not RecoveryStatus.ARCHIVED]
    for outcome in outcomes:
        typer.echo(f"{outcome.status}  {outcome.archive or outcome.path}  {outcome.message}")
    if not outcomes:
        typer.echo(f"nothing to recover in {folder}")
    if any(outcome.status is RecoveryStatus.UNREADABLE for outcome in outcomes):
        raise typer.Exit(FAULT)


def runs(entries: Sequence[Entry], folder: Path, as_json: bool) -> None:
    """Print the entries of a catalogue."""
    if as_json:
        print_json(entries)
        return
    if not entries:
        typer.echo(f"no such archives in {folder}")
        return
    table = ColumnTable()
    table.add_column("run", no_wrap=True)  # so that it can be copied whole
    for head in ("status", "protocol", "rig", "operator", "mean error [mm]"):
        table.add_column(head, overflow="fold")
    optional = [head for head in ("specimen", "study", "tags") if any(getattr(entry, head) for entry in entries)]
    for head in optional:
        table.add_column(head, overflow="fold")
    for entry in entries:
        rig = entry.rig + (" (simulated)" if entry.simulated else "")
        error = "" if entry.mean_error_mm is None else f"{entry.mean_error_mm:.2f}"
        status = "; ".join(filter(None, (entry.status or "unreadable", entry.problem)))
        facts = {"specimen": entry.specimen, "study": entry.study, "tags": ", ".join(entry.tags)}
        cells = (status, entry.protocol, rig, entry.operator, error, *(facts[head] for head in optional))
        table.add_row(entry.run_id or entry.file, *cells)
    console().print(table)


def cycles(specimen: str, count: int, runs_counted: int) -> None:
    """Print how many pressure cycles a specimen has made."""
    counted = f"{runs_counted} run{'' if runs_counted == 1 else 's'}"
    typer.echo(f"specimen {specimen}: {count} pressure cycle{'' if count == 1 else 's'} in {counted} of this folder")
