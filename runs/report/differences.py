"""What differs between runs: their settings, and their measured tips at equal protocol times."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from matplotlib.figure import Figure

from runs.arrays import Array
from runs.records import DetectionStatus
from runs.report import overlay
from runs.report.drawing import decimated
from runs.report.html import DASH, html_table
from runs.report.settings import differing
from runs.run import Run

STEP_S = 1 / 30
"""Spacing of the protocol times at which tips are compared."""
LONGEST_GAP_S = 0.2
"""Between frames further apart nothing is interpolated."""


def table(runs: Sequence[Run]) -> str:
    """Return the table of differing settings."""
    rows = [(escape(name), *(escape(value) or DASH for value in row)) for name, row in differing(runs).items()]
    heads = ("setting", *(escape(overlay.named(run)) for run in runs))
    return html_table(heads, rows) or "<p>All settings of these runs are equal.</p>"


def tips_at_equal_times(runs: Sequence[Run]) -> tuple[Array, Array]:
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


def played_steps(run: Run) -> tuple[tuple[object, ...], ...]:
    """Return kind, start and stop of each step as it was played, at any levels."""
    return tuple((one.kind, one.start_s, one.stop_s) for one in run.header.intervals)


def of_equal_steps(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return the first run and those that have its steps at its times, at any levels: of others no times are equal."""

    def steps(run: Run) -> tuple[object, ...]:
        return run.header.protocol_name, played_steps(run)

    first = runs[0]
    return tuple(run for run in runs if steps(run) == steps(first))


def draw(figure: Figure, runs: Sequence[Run], summaries: object) -> None:
    """Distance of each measured tip from that of the first run at equal protocol times, if its steps are the same."""
    first, *_ = equal = of_equal_steps(runs)
    shown = [k for k, run in enumerate(runs) if k > 0 and run in equal]
    for axes, k, line in overlay.lines(figure, runs, shown):
        time_s, (reference, tip) = tips_at_equal_times([first, runs[k]])
        distance = np.linalg.norm(tip - reference, axis=1)
        axes.plot(*decimated(time_s, distance), **line, label=runs[k].header.run_id + overlay.ended(runs[k]))
    overlay.over_time(figure, "distance [mm]")
