"""The figure of the auxiliary inputs over time."""

from __future__ import annotations

from matplotlib.figure import Figure

from runs.columns import Auxiliary
from runs.report import drawing
from runs.report.colours import MEASURED
from runs.run import Run
from runs.summary import Summary


def size(auxiliary: Auxiliary) -> tuple[float, float]:
    """Size of the figure in inches."""
    return 9.0, 0.8 + 1.5 * len(auxiliary.inputs)


def draw(figure: Figure, run: Run, summary: Summary) -> None:
    """One panel for each input, in its unit."""
    auxiliary = run.auxiliary
    assert auxiliary is not None
    for k, axes in enumerate(drawing.panels(figure, len(auxiliary.inputs))[:, 0]):
        axes.plot(*drawing.decimated(auxiliary.time_s, auxiliary.value[:, k]), color=MEASURED, lw=1.0)
        axes.set_ylabel(f"{auxiliary.inputs[k]} [{auxiliary.units[k]}]", parse_math=False)
        axes.margins(x=0.01)
    axes.set_xlabel("time [s]")
