"""Which figures a run has, with their titles, sizes and captions; and the figures as files of their own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from runs import figures
from runs.run import Run
from runs.summary import SETTLED_PART, Summary, settled_steps, summarise
from runs.text import plain

KINDS = ("pdf", "png", "svg")


@dataclass(frozen=True)
class Plate:
    """One figure: `draw(figure, run, summary)` at a size in inches."""

    name: str
    title: str
    draw: Callable[..., None]
    size: tuple[float, float]
    caption: str = ""


def plates(run: Run, summary: Summary) -> Iterator[Plate]:
    """Yield the figures that a run has something to show in."""
    if summary.ticks:
        yield Plate("pressures", "Pressures and set-points", figures.pressures, (9, 4.1))
    if math.isfinite(summary.plane_deg):
        caption = (
            "In the rod-base frame, drawn as the arm hangs. Circles and crosses: mean over the last "
            f"{100 * SETTLED_PART:.0f} % of each dwell; the numbers are its pressure in bar."
        )
        size = figures.trajectory_size(run, summary)
        yield Plate("trajectory", "Tool centre point in the plane of motion", figures.trajectory, size, caption)
    if settled_steps(summary.steps):
        caption = (
            "Marks: measured, with 95 % of one frame. Normalised by the distance of the measured tip from where it "
            "rested without pressure."
        )
        yield Plate("steps", "Settled tip and error, step by step", figures.steps, (9, 3.6), caption)
    if summary.frames:
        yield Plate("tip", "Tip over time", figures.coordinates, (9, 5))
    if summary.frames_measured:
        yield Plate("error", "Error over time", figures.error, (9, 4.2 if run.simulated else 2.6))
    if summary.lateness_max_us > 0:
        caption = (
            f"Half of the ticks began less than {plain(summary.lateness_p50_us, 1)} us late, 99 % less than "
            f"{plain(summary.lateness_p99_us, 1)} us; the latest {plain(summary.lateness_max_us / 1e3, 2)} ms. "
            f"{summary.missed_deadlines} deadlines missed, {summary.ring_overflows} rows lost between processes."
        )
        yield Plate("timing", "Timing of the control loop", figures.timing, (9, 2.8), caption)


def write(archive: Path | str, folder: Path | str, kind: str = "pdf") -> tuple[Path, ...]:
    """Write each figure of a run as a file `<run>-<figure>.pdf` (or png, svg) for a paper; return the files."""
    if kind not in KINDS:
        raise ValueError(f"no figures as {kind!r}; there are {', '.join(KINDS)}")
    run, place = Run(archive), Path(folder)
    summary = summarise(run)
    place.mkdir(parents=True, exist_ok=True)
    written = []
    for plate in plates(run, summary):
        path = place / f"{run.path.stem}-{plate.name}.{kind}"
        figures.save(plate.draw, plate.size, path, run, summary)
        written.append(path)
    return tuple(written)
