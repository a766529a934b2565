"""Which figures a run has, with their titles, sizes and captions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from runs.report import estimates_figure, figures, pictures
from runs.report.numbers import plain
from runs.run import Run
from runs.summary import MOVED_MM, SETTLED_PART, Summary, settled_steps


@dataclass(frozen=True)
class FigureSpecification:
    """One figure at a size in inches: `draw(figure, run, summary)`, or with the runs and summaries that it compares."""

    name: str
    title: str
    draw: Callable[..., None]
    size: tuple[float, float]
    caption: str = ""


def of_pictures(run: Run, summary: Summary) -> Iterator[FigureSpecification]:
    """Yield the figure of the kept pictures, where there are any; in a page they stand as they were stored."""
    if len(run.frames.time_s):
        yield FigureSpecification("pictures", "Camera", pictures.grid, pictures.grid_size(run, summary))


def figure_specifications(run: Run, summary: Summary) -> Iterator[FigureSpecification]:
    """Yield the figures that a run has something to show in."""
    if summary.ticks:
        asked = np.isfinite(run.pressure.setpoint_bar).any()
        title, height = ("Pressures and set-points", 4.1) if asked else ("Pressures", 3.2)
        yield FigureSpecification("pressures", title, figures.pressures, (9, height))
    if math.isfinite(summary.plane_deg):
        caption = (
            "In the rod-base frame, drawn as the arm hangs. Circles and crosses: mean over the last "
            f"{100 * SETTLED_PART:.0f} % of each dwell; the numbers are its pressure in bar."
        )
        size = figures.trajectory_size(run, summary)
        yield FigureSpecification(
            "trajectory", "Tool centre point in the plane of motion", figures.trajectory, size, caption
        )
    elif _wanders(run):
        caption = "In the rod-base frame: seen along the arm from its tip, and from its side, drawn as the arm hangs."
        yield FigureSpecification("trajectory", "Tool centre point", figures.around, (9, 4.4), caption)
    if run.backbone is not None and run.tip.model_ok.any():
        caption = "The arm as the model has it, drawn as it hangs, and where the camera saw its tip."
        yield FigureSpecification("backbones", "Backbone and measured tip", figures.backbones, (9, 4.8), caption)
    if settled_steps(summary.steps):
        caption = (
            "Marks: measured, with 95 % of one frame. Normalised by the distance of the measured tip from where it "
            "rested without pressure."
        )
        yield FigureSpecification("steps", "Settled tip and error, step by step", figures.steps, (9, 3.6), caption)
    if summary.frames:
        yield FigureSpecification("tip", "Tip over time", figures.coordinates, (9, 5))
    if summary.frames_measured and (run.simulated or math.isfinite(summary.error_mm.mean)):
        yield FigureSpecification("error", "Error over time", figures.error, (9, 4.2 if run.simulated else 2.6))
    if run.adaptation is not None and len(run.adaptation.time_s):
        caption = (
            "Estimated while the run went on, with 95 % bands; dashed: the value that the run began with. Each frame "
            "was predicted before it was used. Nothing of this controlled the run."
        )
        size = estimates_figure.size(run.adaptation)
        yield FigureSpecification(
            "adaptation", "Parameters estimated beside the run", estimates_figure.draw, size, caption
        )
    if summary.lateness_max_us > 0:
        caption = (
            f"Half of the ticks began less than {plain(summary.lateness_p50_us, 1)} us late, 99 % less than "
            f"{plain(summary.lateness_p99_us, 1)} us; the latest {plain(summary.lateness_max_us / 1e3, 2)} ms. "
            f"{summary.missed_deadlines} deadlines missed, {summary.ring_overflows} rows lost between processes."
        )
        yield FigureSpecification("timing", "Timing of the control loop", figures.timing, (9, 2.8), caption)


def _wanders(run: Run) -> bool:
    """Whether the tip moves across the arm, measured or by the model."""
    across = np.vstack((run.tip.measured_mm, run.tip.model_mm))[:, :2]
    across = across[np.isfinite(across).all(axis=1)]
    return len(across) > 0 and bool(np.ptp(across, axis=0).max() > MOVED_MM)
