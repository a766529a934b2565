"""The figures that only some runs have: auxiliary inputs, measured sections, tip paths, and online estimates."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from runs.arrays import Array
from runs.columns import Adaptation, Auxiliary, Sections
from runs.report import drawing
from runs.report.colours import INK, MEASURED, MODEL, MUTED, RUNS, TRUTH
from runs.report.gaps import after_gaps, tip_with_gaps, with_gaps
from runs.run import Run
from runs.summary import Z_95, Summary

_COLUMNS, _NARROW_COLUMNS = 3, 2
"""Panels of estimates beside each other."""
_LABELS = ("x [mm]", "y [mm]", "z [mm]", "distance\nfrom model [mm]")
_AXIS_LABEL = "{} [mm]"


def auxiliary_size(inputs: Auxiliary) -> tuple[float, float]:
    """Size of the figure in inches."""
    return drawing.PAGE_IN, 0.8 + 1.5 * len(inputs.inputs)


def auxiliary(figure: Figure, run: Run, summary: Summary) -> None:
    """One panel for each input, in its unit."""
    inputs = run.auxiliary
    assert inputs is not None
    for k, axes in enumerate(drawing.panels(figure, len(inputs.inputs))[:, 0]):
        axes.plot(*drawing.decimated(inputs.time_s, inputs.value[:, k]), color=MEASURED, lw=1.0)
        axes.set_ylabel(f"{inputs.inputs[k]} [{inputs.units[k]}]", parse_math=False)
        axes.margins(x=0.01)
    axes.set_xlabel("time [s]")


def sections(figure: Figure, run: Run, summary: Summary) -> None:
    """One panel for each coordinate and one for the distance; a colour for each section, dashed for the model."""
    found = run.sections
    assert found is not None
    gaps = after_gaps(found.time_s, run.tip.dropped)
    time_s = with_gaps(found.time_s, gaps)
    panels = drawing.panels(figure, len(_LABELS))[:, 0]
    for k, name in enumerate(found.names):
        colour, label = RUNS[k % len(RUNS)], f"{name}, {found.at_mm[k]:g} mm"
        measured, model = (with_gaps(values[:, k], gaps) for values in (found.measured_mm, found.model_mm))
        for axis, axes in enumerate(panels[:3]):
            axes.plot(*drawing.decimated(time_s, measured[:, axis]), color=colour, lw=1.0, label=label)
            axes.plot(*drawing.decimated(time_s, model[:, axis]), color=colour, lw=0.9, ls=(0, (4, 2)))
        panels[3].plot(*drawing.decimated(time_s, with_gaps(found.error_mm[:, k], gaps)), color=colour, lw=0.8)
    for axes, label in zip(panels, _LABELS, strict=True):
        axes.set_ylabel(label)
        axes.margins(x=0.01)
    panels[2].invert_yaxis()
    panels[3].set_ylim(bottom=0)
    panels[3].set_xlabel("time [s]")
    drawing.legend(panels[0])


def sections_caption(sections: Sections) -> str:
    """What the figure shows."""
    names = ", ".join(f"{name} at {at_mm:g} mm" for name, at_mm in zip(sections.names, sections.at_mm, strict=True))
    return f"Points of the arm's axis in the rod-base frame: {names} from the base. Lines: measured; dashed: the model."


def reference(figure: Figure, run: Run, summary: Summary) -> None:
    """Tip and reference in the plane in which the reference is largest, and the distance over time."""
    path = run.reference
    assert path is not None
    tip, gaps = tip_with_gaps(run.tip)
    target, predicted = (with_gaps(v, gaps) for v in (path.reference_mm, path.predicted_mm))
    on_path = with_gaps(np.where(path.period > 0, 1.0, np.nan), gaps)
    shown = on_path[:, None]
    wanted = target[np.isfinite(on_path)]
    sizes = [float(np.ptp(column)) if len(column) and np.isfinite(column).all() else -1.0 for column in wanted.T]
    first, second = sorted(sorted(range(3), key=sizes.__getitem__)[-2:])
    left, right = drawing.panels(figure, columns=2, width_ratios=[1, 1.6])[0]
    truth = None if run.simulated is None else with_gaps(run.simulated.tip_mm, gaps)
    if truth is not None:
        left.plot(*(truth * shown)[:, [first, second]].T, color=TRUTH, lw=0.9)
    if np.isfinite(tip.measured_mm).any():
        left.plot(*(tip.measured_mm * shown)[:, [first, second]].T, color=MEASURED, lw=0.7)
    left.plot(*(target * shown)[:, [first, second]].T, color=INK, lw=0.8, ls=(0, (4, 2)))
    left.set_aspect("equal", adjustable="datalim")
    if second == 2:
        left.invert_yaxis()
    left.set_xlabel(_AXIS_LABEL.format("xyz"[first]))
    left.set_ylabel("z, along the arm [mm]" if second == 2 else _AXIS_LABEL.format("xyz"[second]))
    if np.isfinite(tip.measured_mm).any():
        error = with_gaps(path.error_mm, gaps)
        right.plot(*drawing.decimated(tip.time_s, error), color=MEASURED, lw=0.8, label="measured")
    for points, colour, label in ((truth, TRUTH, "simulated truth"), (predicted, MODEL, "model")):
        if points is not None:
            right.plot(*drawing.decimated(tip.time_s, _distance(points, target)), color=colour, lw=0.9, label=label)
    right.set_ylabel("distance from reference [mm]")
    right.set_xlabel("time [s]")
    right.set_ylim(bottom=0)
    right.margins(x=0.01)
    drawing.legend(right)


def distance_mm(run: Run) -> tuple[Array, Array]:
    """Protocol times and distance of the tip from its reference, with gaps; the true tip where a run was simulated."""
    assert run.reference is not None
    tip, gaps = tip_with_gaps(run.tip)
    points = tip.measured_mm if run.simulated is None else with_gaps(run.simulated.tip_mm, gaps)
    return tip.protocol_s, _distance(points, with_gaps(run.reference.reference_mm, gaps))


def _distance(points: Array, target: Array) -> Array:
    """Distances (n,) in the coordinates that are controlled; NaN where none is."""
    distance: Array = np.asarray(np.linalg.norm(np.where(np.isnan(target), 0.0, points - target), axis=1))
    distance[np.isnan(target).all(axis=1)] = np.nan
    return distance


def estimates_size(adaptation: Adaptation) -> tuple[float, float]:
    """Size of the figure in inches."""
    return drawing.PAGE_IN, 0.5 + 1.45 * (1 + math.ceil(len(adaptation.parameter) / _COLUMNS))


def estimates(figure: Figure, run: Run, summary: Summary) -> None:
    """The live error with and without the estimates, and each estimate with its 95 % band and where it began."""
    a = run.adaptation
    assert a is not None
    columns = _NARROW_COLUMNS if drawing.narrow(figure) else _COLUMNS
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
