"""Terminal output before and after a run."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from model.units import PA_PER_BAR
from rig.cli.exit_status import DONE, FAULT, INTERRUPTED
from rig.cli.output import ColumnTable, facts_table
from rig.config.drivers import Reality
from rig.config.schema import RigConfig
from rig.execution.plan import RunPlan
from rig.experiment.preflight import peak_pa, trough_pa
from rig.experiment.prepare import PreparedRun
from rig.experiment.run import RunResult
from rig.hardware.safe_state import SafeOutputs
from rig.realtime.scheduling import obtainable, remedies
from rig.realtime.timing_limits import timing_sentence
from runs.printable_text import printable
from runs.records import Status

_EXIT = {Status.FINISHED: DONE, Status.ABORTED: FAULT, Status.INTERRUPTED: INTERRUPTED}
_STATUS = {Status.FINISHED: "bold green", Status.ABORTED: "bold red", Status.INTERRUPTED: "bold yellow"}
_PLOT_LINES = 10


def title(prepared: PreparedRun) -> str:
    """Return a one-line title of a run."""
    how = "virtual time" if prepared.options.fast else "real time"
    marked = " (simulated)" if prepared.config.simulated else ""
    return f"{prepared.protocol.name} on {prepared.config.name}{marked}, {how}, model {prepared.plan.variant}"


def check_screen(prepared: PreparedRun) -> Group:
    """Return the check screen: limits, peak pressure, valves, duration."""
    plan = prepared.plan
    config, trajectory = plan.config, plan.trajectory
    facts = facts_table()
    facts.add_row("protocol", f"{prepared.protocol.name}: {prepared.protocol.title}")
    if prepared.protocol.parameters:
        facts.add_row("parameters", ", ".join(map(str, prepared.protocol.parameters)))
    facts.add_row("duration", f"{trajectory.duration_s:.1f} s, {_counted(len(trajectory.segments), 'segment')}")
    if trajectory.prompts:
        facts.add_row("operator", _counted(len(trajectory.prompts), "prompt"))
    for stream in trajectory.streams:
        numbers = ", ".join(map(str, stream.actuators))
        facts.add_row("set-points", f"of another program for actuators {numbers}, {stream.stop_s - stream.start_s:g} s")
    limits = config.limits
    stopped_bar = limits.pressure_bar + limits.pressure_margin_bar
    held = f"at most {limits.pressure_bar:g} bar in each chamber, above {stopped_bar:g} bar the run is aborted"
    if limits.lowest_pressure_bar < 0:
        stopped_bar = limits.lowest_pressure_bar - limits.pressure_margin_bar
        held += f"; at least {limits.lowest_pressure_bar:g} bar, below {stopped_bar:g} bar the run is aborted"
    facts.add_row("limits", f"{held}; at most {limits.rate_bar_per_s:g} bar/s")
    facts.add_row("rig", f"{config.name}{_how_simulated(config)}, chosen by {prepared.rig_source}")
    facts.add_row("model", f"{plan.variant}, {config.model.mode}")
    if not config.measures_tip:
        facts.add_row("tip", "not measured: the rig has no camera; the run has pressures and the model only")
    if not prepared.options.fast:
        granted = obtainable()
        facts.add_row("timing", timing_sentence(config, granted))
        if config.has_real_valves and (refused := remedies(granted)):
            facts.add_row("", refused)
    peak = peak_bar(plan)
    table, safe_outputs = ColumnTable(), SafeOutputs.of(config.valves).held.tolist()
    for head in ("valve", "actuators", "output", "peak [bar]", "limit [bar]", "safe state"):
        # On a narrow terminal words may wrap; a number must not.
        number = "bar" in head
        table.add_column(head, justify="right" if number else "left", overflow="fold", min_width=5 if number else None)
    for i, (valve, safe) in enumerate(zip(config.valves, safe_outputs, strict=True), 1):
        actuators = ", ".join(str(a) for a in valve.actuators)
        highest = max(peak[a - 1] for a in valve.actuators)
        where = f"{valve.card} AO {valve.channel}"
        state = f"{valve.safe_state} ({safe:g} {valve.output_unit})"
        table.add_row(str(i), actuators, where, f"{highest:.3f}", f"{limits.pressure_bar:.3f}", state)
    return Group(facts, table)


def socket_line() -> str:
    """Return the line that names the control socket of this process, to which other programs send set-points."""
    from rig.realtime.control_socket import socket_of

    return f"socket for set-points  {socket_of(os.getpid())}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _how_simulated(config: RigConfig) -> str:
    emulated = [name for name, card in config.cards.items() if card.reality is Reality.EMULATED]
    if emulated:
        return f" (SIMULATED: card {', '.join(emulated)} is stated as an emulated board)"
    real = [f"card {name}" for name, card in config.cards.items() if card.reality is Reality.REAL]
    real += [f"camera {name}" for name, camera in config.cameras.items() if camera.reality is Reality.REAL]
    real += [f"tracker {name}" for name, tracker in config.trackers.items() if tracker.reality is Reality.REAL]
    if real:
        verb = "is" if len(real) == 1 else "are"
        return f" (SIMULATED in part: {', '.join(real)} {verb} real)" if config.simulated else ""
    return " (SIMULATED: no hardware is touched)"


def verdict(prepared: PreparedRun) -> Text:
    """Return the verdict on a run that has passed every check, and the metadata that `rig run` needs beside it."""
    verdict = Text(f"nothing is wrong: rig {prepared.config.name} can run {prepared.protocol.name}", "bold green")
    if missing := _missing_metadata(prepared):
        needed = " ".join(f"--meta {name}=VALUE" for name in missing)
        verdict.append(f"\nthe rig file requires metadata: rig run needs {needed}", "yellow")
    return verdict


def _missing_metadata(prepared: PreparedRun) -> tuple[str, ...]:
    return prepared.config.metadata.missing(prepared.metadata)


def peak_bar(plan: RunPlan) -> list[float]:
    """Return the highest set-point of each actuator [bar]."""
    return [pa / PA_PER_BAR for pa in peak_pa(plan.trajectory)]


def check_facts(prepared: PreparedRun) -> dict[str, object]:
    """Return the check screen for JSON."""
    plan = prepared.plan
    return {
        "protocol": prepared.protocol.name,
        "parameters": {p.name: p.value for p in prepared.protocol.parameters},
        "rig": prepared.config.name,
        "rig_source": str(prepared.rig_source),
        "simulated": prepared.config.simulated,
        "duration_s": plan.trajectory.duration_s,
        "segments": len(plan.trajectory.segments),
        "prompts": len(plan.trajectory.prompts),
        "peak_bar": peak_bar(plan),
        "limit_bar": prepared.config.limits.pressure_bar,
        "missing_metadata": _missing_metadata(prepared),
        **_tip_paths_json(plan),
    }


def _tip_paths_json(plan: RunPlan) -> dict[str, object]:
    """Return the assessments of the tip paths; nothing for a protocol without any."""
    if not plan.trajectory.tip:
        return {}
    from rig.tip_planning.assessment import assess

    return {"tip_paths": assess(plan.config, plan.trajectory, plan.variant)}


def setpoint_plot(plan: RunPlan, width: int) -> Text:
    """Plot the set-points over time as text; actuators with equal set-points share a symbol."""
    columns = max(20, min(width, 110) - 12)
    times = np.linspace(0.0, plan.trajectory.duration_s, columns)
    levels = plan.trajectory.sample(times) / PA_PER_BAR
    alike: dict[bytes, list[int]] = {}
    for actuator, column in enumerate(levels.T, 1):
        alike.setdefault(column.tobytes(), []).append(actuator)
    low, top = min(0.0, trough_pa(plan.trajectory) / PA_PER_BAR), max(0.0, max(peak_bar(plan)))
    span = top - low
    lines_up = _PLOT_LINES if span > 0 else 0
    grid = [[" "] * columns for _ in range(lines_up + 1)]
    for numbers in reversed(alike.values()):
        for column, level in enumerate(levels[:, numbers[0] - 1]):
            grid[round(lines_up * (top - float(level)) / span) if lines_up else 0][column] = str(numbers[0])
    digits = 2 if span >= 0.1 or not lines_up else 4
    lines = [f"{top - span * i / max(lines_up, 1):6.{digits}f} bar {''.join(row)}" for i, row in enumerate(grid)]
    end = f"{plan.trajectory.duration_s:.0f} s"
    lines.append(" " * 11 + "0 s" + end.rjust(columns - 3))
    lines += [f"{numbers[0]}: actuators {', '.join(map(str, numbers))}" for numbers in alike.values() if numbers[1:]]
    return Text("\n".join(lines), no_wrap=True, overflow="crop")


def tip_paths(plan: RunPlan) -> Table:
    """Return margins and expected errors of the tip paths."""
    from rig.tip_planning.assessment import assess

    table = facts_table()
    for path in assess(plan.config, plan.trajectory, plan.variant):
        causes = ", ".join(f"{name} {error:.2g}" for name, error in path.causes)
        table.add_row("tip path", f"{path.label}: up to {path.fastest_mm_s:.1f} mm/s")
        table.add_row(
            "margins",
            f"{path.low_margin_bar:.3f} bar to 0, {path.high_margin_bar:.3f} bar to the limit, "
            f"{path.rate_margin_bar_s:.2f} bar/s; another arm needs +-{path.pressure_std_bar:.3f} bar (one sigma)",
        )
        table.add_row(
            "expected",
            f"tip error {path.expected_error_mm:.2g} mm (one sigma, without feedback; {causes} mm); "
            f"of the model {path.model_error_mm:.3f} mm",
        )
    return table


def confirm(screen: Console) -> bool:
    """Ask the operator to arm the rig."""
    if not sys.stdin.isatty():
        screen.print("standard input is not a terminal: use --yes to arm without confirmation")
        return False
    try:
        return screen.input("Arm the rig and run? [y/N] ", markup=False).strip().lower() in ("y", "yes")
    except (EOFError, UnicodeDecodeError):
        return False


def last_screen(screen: Console, result: RunResult) -> None:
    """Print how the run ended, its summary and its files. A closed terminal raises no error."""
    outcome = result.outcome
    ending = f"{outcome.status}: {outcome.message}" if outcome.message else str(outcome.status)
    parts: list[RenderableType] = [Text(printable(ending), _STATUS[outcome.status])]
    if (summary := result.summary) is not None:
        from rig.cli.archive_output import summary_table

        parts.append(summary_table(summary, outcome.counters))
        if summary.frames and summary.camera and not summary.frames_measured:
            question = "does the camera see the board, or the tracker the body?"
            parts.append(Text(f"no tip was measured in {summary.frames} frames: {question}", "bold red"))
    if result.archive is not None:
        parts.append(f"archive  {result.archive}")
    if result.report is not None:
        parts.append(f"report   {result.report}")
    if result.parameters is not None:
        parts.append(f"adapted  {result.parameters}  (from positions of the tip alone; use them: --parameters FILE)")
    parts += [Text(printable(warning), "bold red") for warning in result.warnings]
    try:
        for part in parts:
            screen.print(part, soft_wrap=not isinstance(part, Table))
    except (OSError, SystemExit):  # rich raises SystemExit for a closed pipe
        # Otherwise the interpreter flushes the stream again at exit and changes the exit status.
        with suppress(OSError), Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), screen.file.fileno())


def result_facts(result: RunResult) -> dict[str, object]:
    """Return the result of a run for JSON."""
    from rig.cli.archive_output import summary_facts

    return {
        "status": str(result.outcome.status),
        "message": result.outcome.message,
        "archive": str(result.archive) if result.archive else None,
        "report": str(result.report) if result.report else None,
        "parameters": str(result.parameters) if result.parameters else None,
        "warnings": result.warnings,
        "counters": result.outcome.counters,
        "summary": summary_facts(result.archive) if result.archive else None,
    }


def exit_status(result: RunResult) -> int:
    """Return the exit status: 0 finished, 1 aborted, not archived or without its tip controller, 130 interrupted."""
    return _EXIT[result.outcome.status] or (FAULT if result.warnings or result.outcome.message else DONE)
