"""The figures of a report: which a run has, with their titles, sizes and captions.

A new figure is one function of a run and its summary, and its entry in `FIGURES`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from runs.report import figures, further_figures, pictures
from runs.report.drawing import PAGE_IN, FigureSpecification
from runs.report.html import listed, plain
from runs.run import Run
from runs.summary import MOVED_MM, SETTLED_PART, Summary, settled_steps

Z_DOWN = "z points from the base along the hanging arm and is drawn downwards."


def figure_specifications(run: Run, summary: Summary) -> Iterator[FigureSpecification]:
    """Yield the figures that a run has something to show in, in the order of the page."""
    for figure in FIGURES:
        if (specification := figure(run, summary)) is not None:
            yield replace(specification, about=(run, summary))


def of_pictures(run: Run, summary: Summary) -> Iterator[FigureSpecification]:
    """Yield the figure of the kept pictures, if there are any; the page shows the pictures themselves."""
    if len(run.frames.time_s):
        size = pictures.grid_size(run, summary)
        yield FigureSpecification("pictures", "Camera", pictures.grid, size, about=(run, summary))


def _pressures(run: Run, summary: Summary) -> FigureSpecification | None:
    if not summary.cycles:
        return None
    setpoints = np.isfinite(run.pressure.setpoint_bar).any()
    title, height = ("Pressures and set-points", 3.7) if setpoints else ("Pressures", 2.8)
    return FigureSpecification("pressures", title, figures.pressures, (PAGE_IN, height))


def _auxiliary(run: Run, summary: Summary) -> FigureSpecification | None:
    if run.auxiliary is None or not summary.cycles:
        return None
    size = further_figures.auxiliary_size(run.auxiliary)
    return FigureSpecification("inputs", "Auxiliary inputs", further_figures.auxiliary, size)


def _trajectory(run: Run, summary: Summary) -> FigureSpecification | None:
    if math.isfinite(summary.plane_deg):
        title = "Tool centre point in the plane of motion"
        caption = f"In the rod-base frame. {Z_DOWN}"
        if dwells := settled_steps(summary.steps):
            loads = (
                ("pressure in bar", any(step.extreme_bar != 0 for step in dwells)),
                (
                    "weight in g",
                    any(step.extreme_bar == 0 for step in dwells),
                ),
            )
            numbers = " or ".join(name for name, present in loads if present)
            caption += (
                f" Circles and crosses: mean over the last {100 * SETTLED_PART:.0f} % of each dwell; the numbers are "
                f"its {numbers}."
            )
        size = figures.trajectory_size(run, summary)
        return FigureSpecification("trajectory", title, figures.trajectory, size, caption)
    if _leaves_axis(run):
        caption = f"In the rod-base frame: seen along the arm from its tip, and from its side. {Z_DOWN}"
        return FigureSpecification("trajectory", "Tool centre point", figures.around, (PAGE_IN, 3.5), caption, beside=2)
    return None


def _backbones(run: Run, summary: Summary) -> FigureSpecification | None:
    if run.backbone is None or not run.tip.model_ok.any():
        return None
    measured = " and measured tip" if summary.frames_measured else ""
    caption = f"The modelled arm{measured.replace('measured', 'the measured')}; right: its tip, enlarged. {Z_DOWN}"
    return FigureSpecification("backbones", f"Backbone{measured}", figures.backbones, (PAGE_IN, 3.9), caption, beside=2)


def _steps(run: Run, summary: Summary) -> FigureSpecification | None:
    if not settled_steps(summary.steps):
        return None
    caption = "Marks: measured, with 95 % of one frame. z points down along the hanging arm; its negative is drawn."
    if (figures.from_rest_mm(run, summary) > MOVED_MM).any():
        caption += " Errors over the distance of the measured tip from its position at rest without pressure."
    return FigureSpecification(
        "steps", "Settled tip and error, step by step", figures.steps, (PAGE_IN, 3.2), caption, beside=2
    )


def _tip(run: Run, summary: Summary) -> FigureSpecification | None:
    if not summary.frames:
        return None
    caption = f"In the rod-base frame. {Z_DOWN}"
    return FigureSpecification("tip", "Tip over time", figures.coordinates, (PAGE_IN, 4.6), caption)


def _error(run: Run, summary: Summary) -> FigureSpecification | None:
    if not summary.frames_measured or not (run.simulated or math.isfinite(summary.error_mm.mean)):
        return None
    return FigureSpecification("error", "Error over time", figures.error, (PAGE_IN, 3.7 if run.simulated else 2.5))


def _sections(run: Run, summary: Summary) -> FigureSpecification | None:
    if run.sections is None or not summary.frames:
        return None
    caption = f"{further_figures.sections_caption(run.sections)} {Z_DOWN}"
    return FigureSpecification("sections", "Measured sections", further_figures.sections, (PAGE_IN, 5.8), caption)


def _reference(run: Run, summary: Summary) -> FigureSpecification | None:
    if run.reference is None or summary.tip_path is None:
        return None
    path = summary.tip_path
    periods = (path.truth or path.measured).periods_mm
    caption = (
        "Dashed: the reference. Right: distance of the tip from it, in the controlled coordinates. The "
        f"model's is that under the feed-forward set-points, {plain(path.predicted_mm, 3)} mm rms on the path."
    )
    if len(periods) > 1:
        caption += f" Rms of each period: {listed(periods, 3)} mm."
    return FigureSpecification(
        "reference", "Tip and reference", further_figures.reference, (PAGE_IN, 3.6), caption, beside=2
    )


def _adaptation(run: Run, summary: Summary) -> FigureSpecification | None:
    if run.adaptation is None or not len(run.adaptation.time_s):
        return None
    caption = (
        "Estimated during the run, with 95 % bands; dashed: the initial value. Each frame was predicted before it was "
        "used. Control did not use the estimates."
    )
    size = further_figures.estimates_size(run.adaptation)
    return FigureSpecification("adaptation", "Parameters estimated online", further_figures.estimates, size, caption)


def _timing(run: Run, summary: Summary) -> FigureSpecification | None:
    if not summary.lateness_max_us > 0:
        return None
    caption = (
        f"Half of the control cycles began less than {plain(summary.lateness_p50_us, 1)} us late, 99 % less than "
        f"{plain(summary.lateness_p99_us, 1)} us; the latest {plain(summary.lateness_max_us / 1e3, 2)} ms. "
        f"{summary.missed_deadlines} deadlines missed, {summary.ring_overflows} rows lost between processes."
    )
    return FigureSpecification(
        "timing", "Timing of the control loop", figures.timing, (PAGE_IN, 2.7), caption, beside=2
    )


FIGURES: tuple[Callable[[Run, Summary], FigureSpecification | None], ...] = (
    _reference,
    _adaptation,
    _trajectory,
    _pressures,
    _steps,
    _error,
    _backbones,
    _tip,
    _sections,
    _auxiliary,
    _timing,
)
"""Each returns its figure, or None for a run without data for it, in the order of the page."""
LEADING = 4
"""Figures of a run that stand first; the others are folded."""


def _leaves_axis(run: Run) -> bool:
    """Return whether the measured or modelled tip moves across the arm."""
    across = np.vstack((run.tip.measured_mm, run.tip.model_mm))[:, :2]
    across = across[np.isfinite(across).all(axis=1)]
    return len(across) > 0 and bool(np.ptp(across, axis=0).max() > MOVED_MM)
