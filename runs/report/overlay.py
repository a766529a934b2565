"""Runs overlaid, so that every line shows: a few in each panel, earlier ones as wider lines beneath."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from runs.records import Status
from runs.report.colours import RUNS
from runs.report.drawing import PAGE_IN, legend
from runs.run import Run

STYLES = ("-", (0, (6, 1.5)), (0, (6, 1.5, 1, 1.5)))
WIDEST, NARROWEST = 2.6, 0.9
MOST = 4
"""Lines in a panel that are distinct where they coincide; wider ones would hide the scale of what they show."""


def ended(run: Run) -> str:
    """Return how a run ended that did not finish, in brackets; empty for a finished one."""
    return "" if run.status is Status.FINISHED else f" ({run.status})"


def named(run: Run, name: str | None = None) -> str:
    """Return the id of a run, or another name, with its marks in every table: simulated, and how it ended early."""
    return (name or run.header.run_id) + " (simulated)" * run.header.simulated + ended(run)


def panel_count(lines: int) -> int:
    """Return the number of panels for lines of runs."""
    return max(1, math.ceil(lines / MOST))


def size(lines: int, panel_in: float) -> tuple[float, float]:
    """Return the size in inches of a figure whose panels are this high, each with a legend of its runs."""
    return PAGE_IN, panel_in * panel_count(lines) + 0.16 * lines


def caption(lines: int) -> str:
    """Return the sentences about panels and widths of lines; nothing for a single line."""
    if lines < 2:
        return ""
    if lines <= MOST:
        return " Wide lines lie beneath: those of the first run are the widest."
    return (
        f" At most {MOST} runs in a panel, on equal axes. Wide lines lie beneath: the first of a panel is the widest."
    )


def lines(figure: Figure, runs: Sequence[Run], shown: Sequence[int]) -> Iterator[tuple[Axes, int, dict[str, Any]]]:
    """Yield panel, index in `runs` and line of each run that is shown; its colour is the same in every figure.

    Colour and dashes are another pair, up to three times the colours. A later line is narrower, so that an earlier one
    shows at its sides where both coincide.
    """
    count = panel_count(len(shown))
    panels = figure.subplots(count, 1, squeeze=False)[:, 0]
    for panel, axes in enumerate(panels):
        first, end = (math.ceil(k * len(shown) / count) for k in (panel, panel + 1))
        beside = shown[first:end]
        step = (WIDEST - NARROWEST) / max(len(beside) - 1, 1)
        for k, index in enumerate(beside):
            dashes = STYLES[index // len(RUNS) % len(STYLES)]
            width = NARROWEST + step * (len(beside) - 1 - k)
            yield axes, index, {"color": RUNS[index % len(RUNS)], "ls": dashes, "lw": width}


def align(figure: Figure) -> tuple[Axes, ...]:
    """Give all panels the same limits, so that what they show can be compared; return them."""
    panels = tuple(figure.axes)
    corners = np.concatenate([axes.dataLim.get_points() for axes in panels])
    for axes in panels:
        axes.update_datalim(corners[np.isfinite(corners).all(axis=1)])
        axes.autoscale_view()
    return panels


def over_time(figure: Figure, label: str) -> None:
    """Finish panels of lengths over protocol time."""
    for axes in align(figure):
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
        legend(axes, columns=2)
    figure.axes[-1].set_xlabel("protocol time [s]")
