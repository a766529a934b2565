"""The figure of a tip path: tip and reference seen from the tip and from the side, and their distance over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from runs.arrays import Array
from runs.report import drawing
from runs.report.colours import INK, MEASURED, MODEL, TRUTH
from runs.report.gaps import tip_with_gaps, with_gaps
from runs.run import Run
from runs.summary import Summary

AXES = "xyz"
AXIS_LABEL = "{} [mm]"


def draw(figure: Figure, run: Run, summary: Summary) -> None:
    """Tip and reference in the plane in which the reference is largest, and the distance over time."""
    reference = run.reference
    assert reference is not None
    tip, gaps = tip_with_gaps(run.tip)
    target, predicted = (with_gaps(v, gaps) for v in (reference.reference_mm, reference.predicted_mm))
    on_path = with_gaps(np.where(reference.period > 0, 1.0, np.nan), gaps)
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
    left.set_xlabel(AXIS_LABEL.format(AXES[first]))
    left.set_ylabel("z, along the arm [mm]" if second == 2 else AXIS_LABEL.format(AXES[second]))
    if np.isfinite(tip.measured_mm).any():
        error = with_gaps(reference.error_mm, gaps)
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
