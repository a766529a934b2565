"""The figure of the measured sections: their points over time with the model's, and the distance of the two."""

from __future__ import annotations

from matplotlib.figure import Figure

from runs.columns import Sections
from runs.report import drawing
from runs.report.colours import RUNS
from runs.report.gaps import after_gaps, with_gaps
from runs.run import Run
from runs.summary import Summary

LABELS = ("x [mm]", "y [mm]", "z [mm]", "distance\nfrom model [mm]")


def draw(figure: Figure, run: Run, summary: Summary) -> None:
    """One panel for each coordinate and one for the distance; a colour for each section, dashed for the model."""
    sections = run.sections
    assert sections is not None
    gaps = after_gaps(sections.time_s, run.tip.dropped)
    time_s = with_gaps(sections.time_s, gaps)
    panels = drawing.panels(figure, len(LABELS))[:, 0]
    for k, name in enumerate(sections.names):
        colour, label = RUNS[k % len(RUNS)], f"{name}, {sections.at_mm[k]:g} mm"
        measured, model = (with_gaps(values[:, k], gaps) for values in (sections.measured_mm, sections.model_mm))
        for axis, axes in enumerate(panels[:3]):
            axes.plot(*drawing.decimated(time_s, measured[:, axis]), color=colour, lw=1.0, label=label)
            axes.plot(*drawing.decimated(time_s, model[:, axis]), color=colour, lw=0.9, ls=(0, (4, 2)))
        panels[3].plot(*drawing.decimated(time_s, with_gaps(sections.error_mm[:, k], gaps)), color=colour, lw=0.8)
    for axes, label in zip(panels, LABELS, strict=True):
        axes.set_ylabel(label)
        axes.margins(x=0.01)
    panels[2].invert_yaxis()
    panels[3].set_ylim(bottom=0)
    panels[3].set_xlabel("time [s]")
    drawing.legend(panels[0])


def caption(sections: Sections) -> str:
    """What the figure shows."""
    names = ", ".join(f"{name} at {at_mm:g} mm" for name, at_mm in zip(sections.names, sections.at_mm, strict=True))
    return f"Points of the arm's axis in the rod-base frame: {names} from the base. Lines: measured; dashed: the model."
