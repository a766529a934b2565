"""The figure of parameters estimated beside a run: over time, with their bands."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from runs.columns import Adaptation
from runs.report import drawing
from runs.report.colours import INK, MEASURED, MUTED
from runs.report.gaps import tip_with_gaps, with_gaps
from runs.run import Run
from runs.summary import Z_95, Summary

COLUMNS, NARROW_COLUMNS = 3, 2


def size(adaptation: Adaptation) -> tuple[float, float]:
    """Size of the figure in inches."""
    return 9.0, 0.5 + 1.45 * (1 + math.ceil(len(adaptation.parameter) / COLUMNS))


def draw(figure: Figure, run: Run, summary: Summary) -> None:
    """The live error with and without the estimates, and each estimate with its 95 % band and where it began."""
    a = run.adaptation
    assert a is not None
    columns = NARROW_COLUMNS if drawing.narrow(figure) else COLUMNS
    rows = math.ceil(len(a.parameter) / columns)
    grid = figure.add_gridspec(1 + rows, columns)
    above = figure.add_subplot(grid[0, :])
    # A run that was cut off may have a frame without what it taught.
    tip, gaps = tip_with_gaps(run.tip)
    _, of_tip, of_estimate = np.intersect1d(run.tip.frame, a.frame, return_indices=True)
    start_mm = np.full_like(run.tip.measured_mm, np.nan)
    start_mm[of_tip] = a.start_model_mm[of_estimate]
    without = np.linalg.norm(tip.measured_mm - with_gaps(start_mm, gaps), axis=1)
    above.plot(*drawing.decimated(tip.time_s, without), color=MUTED, lw=0.9, label="with the parameters as they were")
    above.plot(*drawing.decimated(tip.time_s, tip.error_mm), color=MEASURED, lw=1.0, label="live error")
    above.set_ylabel("error [mm]")
    above.set_ylim(bottom=0)
    above.margins(x=0.01)
    drawing.legend(above)
    for k, (name, unit) in enumerate(zip(a.parameter, a.unit, strict=True)):
        panel = figure.add_subplot(grid[1 + k // columns, k % columns])
        index = drawing.decimated_indices(a.value[:, k])
        time, value, half = a.time_s[index], a.value[index, k], Z_95 * a.uncertainty[index, k]
        panel.axhline(a.start[k], color=INK, lw=0.8, ls=(0, (4, 2)))
        panel.fill_between(time, value - half, value + half, color=MEASURED, alpha=0.2, lw=0)
        panel.plot(time, value, color=MEASURED)
        panel.set_title(f"{name} [{unit}]", fontsize=8.5, parse_math=False)
        panel.margins(x=0.01)
        panel.ticklabel_format(axis="y", style="sci", scilimits=(-2, 4), useMathText=True)
        panel.yaxis.get_offset_text().set_fontsize(7.5)
        panel.tick_params(labelsize=7.5)
        if k + columns >= len(a.parameter):
            panel.set_xlabel("time [s]")
