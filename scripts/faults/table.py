"""The campaign's table in Markdown."""

from __future__ import annotations

import math
import re
import statistics
from collections.abc import Sequence
from pathlib import Path

from scripts.faults.fault import Fault, FaultTrial
from scripts.faults.fault_trial import worst

BEGIN, END = "<!-- campaign: written by `make faults` -->", "<!-- end of campaign -->"

_TEMPORARY = re.compile(r"/\S*softrig-faults-\S*")


def write(page: Path, faults: Sequence[Fault], trials: Sequence[FaultTrial]) -> None:
    """Replace the table between the two marks of a page."""
    text = page.read_text()
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}\n\n{table(faults, trials)}\n{END}{after}")


def table(faults: Sequence[Fault], trials: Sequence[FaultTrial]) -> str:
    """One row per fault and executor, and a summary."""
    tried = [trial for trial in trials if not trial.skipped]
    bad = sum(bool(trial.wrong) for trial in tried)
    unsafe = sum("NOT SAFE" in trial.wrong for trial in tried)
    silent = sum("no message to the operator" in trial.wrong for trial in tried)
    lines = [
        f"{len(tried)} trials of {len({t.fault for t in tried})} faults at random moments: "
        f"**{unsafe} left unsafe where a program can help, {silent} not reported, {bad} failed**; "
        f"at most {1e3 * worst([t.lost_s for t in tried]):.0f} ms of samples lost.",
        "",
        "| fault | executor | trials | safe after, median (worst) | samples lost | archive | passed | "
        "message to the operator |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for fault in faults:
        for executor in ("real", "virtual"):
            mine = [t for t in trials if (t.fault, t.executor) == (fault.name, executor)]
            if mine:
                lines.append(_row(fault, executor, mine))
    return "\n".join(lines) + "\n"


def _row(fault: Fault, executor: str, trials: Sequence[FaultTrial]) -> str:
    tried = [t for t in trials if not t.skipped]
    name = fault.name + (f" ({fault.remark})" if fault.remark else "")
    if not tried:
        return f"| {name} | {executor} | 0 | | | | | not tried here: {trials[0].skipped} |"
    good = sum(not t.wrong for t in tried)
    message = max((t.message for t in tried), key=len).replace("|", "\\|")
    message = _TEMPORARY.sub("...", message)
    statuses = ", ".join(sorted({t.status for t in tried}))
    lost = 1e3 * worst([t.lost_s for t in tried])
    as_it_must = f"{good} of {len(tried)}" if good < len(tried) else "all"
    cells = (name, executor, len(tried), _times(fault, tried), f"{lost:.0f} ms", statuses, as_it_must, message)
    return f"| {' | '.join(map(str, cells))} |"


def _times(fault: Fault, trials: Sequence[FaultTrial]) -> str:
    times = [t.safe_s for t in trials if not math.isnan(t.safe_s)]
    if not fault.safe:
        return "never by program"
    if not times:
        return "at the end"
    return f"{_duration(statistics.median(times))} ({_duration(max(times))})"


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"
