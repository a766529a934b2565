"""What differs between runs: their settings, and their measured tips at equal protocol times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from itertools import chain

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from runs.records import DetectionStatus
from runs.report.colours import RUNS
from runs.report.drawing import decimated, legend
from runs.report.numbers import DASH, plain
from runs.run import Run

Floats = NDArray[np.float64]
STEP_S = 1 / 30
"""Spacing of the protocol times at which tips are compared."""
LONGEST_GAP_S = 0.2
"""Between frames further apart nothing is interpolated."""


def settings(run: Run) -> dict[str, str]:
    """Return everything that was set for a run, by name."""
    header = run.header
    found = {
        "protocol": header.protocol_name,
        "rig": header.rig_name,
        "model": header.model_variant,
        "executor": header.executor,
        "seed": "" if header.seed is None else str(header.seed),
        "tip controller": header.tip_controller,
        "learned from": ", ".join(header.learned_from),
        "operator": header.operator,
        "commit": header.git_commit[:12] + (" with changes" if header.git_diff else ""),
    }
    found |= {f"protocol {q.name} [{q.unit or '1'}]": _numbers(q.value) for q in header.protocol_parameters}
    others = (q for q in header.quantities if q.room != "protocol")
    found |= {f"{q.room} {q.name} [{q.unit}]": _numbers(q.value) for q in others}
    found |= {f"metadata {name}": text for name, text in header.metadata.items()}
    found |= {f"version of {name}": text for name, text in header.versions.items()}
    found |= {f"{name} (SHA-256)": file for name, file in _file_sums(run)}
    return found


def _file_sums(run: Run) -> list[tuple[str, str]]:
    files = chain(run.header.calibrations, run.header.protocol_files)
    return [(f"file {file.name}", file.sha256[:12]) for file in files]


def _numbers(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


def differing(runs: Sequence[Run]) -> dict[str, tuple[str, ...]]:
    """Return the settings that are not equal in all runs, with the value of each run; empty where it has none."""
    each = [settings(run) for run in runs]
    names = dict.fromkeys(name for one in each for name in one)
    values = {name: tuple(one.get(name, "") for one in each) for name in names}
    return {name: row for name, row in values.items() if len(set(row)) > 1}


def table(runs: Sequence[Run]) -> str:
    """Return the table of differing settings."""
    rows = differing(runs)
    if not rows:
        return "<h2>Settings</h2>\n<p>All settings of these runs are equal.</p>\n"
    head = "".join(f"<th>{escape(run.header.run_id)}</th>" for run in runs)
    body = "".join(
        f"<tr><th>{escape(name)}</th>{''.join(f'<td>{escape(value) or DASH}</td>' for value in row)}</tr>"
        for name, row in rows.items()
    )
    return f'<h2>Differing settings</h2>\n<div class="scroll"><table><tr><th></th>{head}</tr>{body}</table></div>\n'


def tips_at_equal_times(runs: Sequence[Run]) -> tuple[Floats, Floats]:
    """Return protocol times (n,) [s] and the measured tips (runs, n, 3) [mm] at them, interpolated; NaN in gaps."""
    known = [run.tip.seen == DetectionStatus.MEASURED for run in runs]
    if not all(seen.sum() > 1 for seen in known):
        return np.empty(0), np.empty((len(runs), 0, 3))
    times = [run.tip.protocol_s[seen] for run, seen in zip(runs, known, strict=True)]
    grid = np.arange(max(t[0] for t in times), min(t[-1] for t in times), STEP_S)
    tips = np.full((len(runs), len(grid), 3), np.nan)
    for k, (run, seen, time_s) in enumerate(zip(runs, known, times, strict=True)):
        after = np.clip(np.searchsorted(time_s, grid), 1, len(time_s) - 1)
        near = time_s[after] - time_s[after - 1] <= LONGEST_GAP_S
        for axis in range(3):
            tips[k, :, axis] = np.where(near, np.interp(grid, time_s, run.tip.measured_mm[seen, axis]), np.nan)
    return grid, tips


def of_equal_steps(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return the first run and those that have its steps at its times, at any levels: of others no times are equal."""

    def steps(run: Run) -> tuple[tuple[object, ...], ...]:
        return tuple((one.kind, one.start_s, one.stop_s) for one in run.header.intervals)

    first = runs[0]
    return tuple(
        run for run in runs if (run.header.protocol_name, steps(run)) == (first.header.protocol_name, steps(first))
    )


def repeatability_mm(tips_mm: Floats) -> float:
    """Return the standard deviation of repeated tips (runs, n, 3) about their mean, pooled over time; 3-D."""
    variance = tips_mm.var(axis=0, ddof=1).sum(axis=1) if len(tips_mm) > 1 else np.empty(0)
    known = variance[np.isfinite(variance)]
    return float(np.sqrt(known.mean())) if len(known) else math.nan


def repeatability(runs: Sequence[Run]) -> str:
    """Return a sentence on the repeatability of runs with one protocol and one set of parameters; else nothing."""
    asked = {(run.header.protocol_yaml, tuple(map(str, run.header.protocol_parameters))) for run in runs}
    if len(asked) > 1:
        return ""
    found = repeatability_mm(tips_at_equal_times(runs)[1])
    if not math.isfinite(found):
        return ""
    return (
        f"<p>Repeatability: the measured tips of these {len(runs)} runs of one protocol scatter by "
        f"{plain(found, 3)} mm (3-D standard deviation about their mean at equal protocol times).</p>\n"
    )


def draw(figure: Figure, runs: Sequence[Run], summaries: object) -> None:
    """Distance of each measured tip from that of the first run at equal protocol times, if its steps are the same."""
    axes = figure.subplots()
    first, *_ = equal = of_equal_steps(runs)
    for k, run in enumerate(runs):
        if run is first or run not in equal:
            continue
        time_s, (reference, tip) = tips_at_equal_times([first, run])
        distance = np.linalg.norm(tip - reference, axis=1)
        axes.plot(*decimated(time_s, distance), color=RUNS[k % len(RUNS)], lw=1.0, label=run.header.run_id)
    axes.set_xlabel("protocol time [s]")
    axes.set_ylabel(f"distance from\n{first.header.run_id} [mm]")
    axes.set_ylim(bottom=0)
    legend(axes, columns=2)
