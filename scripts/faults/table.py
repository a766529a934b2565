"""The campaign's table in Markdown."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from pathlib import Path

from scripts.faults.fault import Fault, FaultTrial
from scripts.faults.fault_trial import worst

BEGIN, END = "<!-- campaign: written by `make faults` -->", "<!-- end of campaign -->"


def write(page: Path, faults: Sequence[Fault], trials: Sequence[FaultTrial]) -> None:
    """Replace the table between the two marks of a page."""
    text = page.read_text()
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}\n\n{table(faults, trials)}\n{END}{after}")


def table(faults: Sequence[Fault], trials: Sequence[FaultTrial]) -> str:
    """One row per fault, and a summary."""
    tried = [trial for trial in trials if not trial.skipped]
    bad = sum(bool(trial.wrong) for trial in tried)
    unsafe = sum("NOT SAFE" in trial.wrong for trial in tried)
    silent = sum("no message to the operator" in trial.wrong for trial in tried)
    lines = [
        f"{len(tried)} trials of {len({t.fault for t in tried})} faults at random moments: "
        f"**{unsafe} left unsafe where a program can help, {silent} not reported, {bad} failed**; "
        f"at most {1e3 * worst([t.lost_s for t in tried]):.0f} ms of samples lost.",
        "",
        "| fault | trials | safe after, median (worst) | archive |",
        "|---|---|---|---|",
    ]
    for fault in faults:
        mine = [trial for trial in trials if trial.fault == fault.name]
        if mine:
            lines.append(_row(fault, mine))
    return "\n".join(lines) + "\n"


def _row(fault: Fault, trials: Sequence[FaultTrial]) -> str:
    """A fault in both executors; figures of the real one stand before those of the virtual one."""
    by_executor = [[t for t in trials if t.executor == executor and not t.skipped] for executor in ("real", "virtual")]
    there = [tried for tried in by_executor if tried]
    if not there:
        return f"| {fault.name} | not tried: {trials[0].skipped} | | |"
    good = sum(not t.wrong for tried in there for t in tried)
    count = sum(len(tried) for tried in there)
    counts = str(count) if good == count else f"{count}, {count - good} failed"
    # Both executors may state the same, such as that the valves are safe at the end of the run.
    times = " / ".join(dict.fromkeys(_times(fault, tried) for tried in there))
    statuses = ", ".join(sorted({t.status for tried in there for t in tried}))
    return f"| {fault.name} | {counts} | {times} | {statuses} |"


def _times(fault: Fault, trials: Sequence[FaultTrial]) -> str:
    times = [t.safe_s for t in trials if not math.isnan(t.safe_s)]
    if not fault.safe:
        return "never by program"
    if not times:
        return "at the end"
    return f"{_duration(statistics.median(times))} ({_duration(max(times))})"


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"
