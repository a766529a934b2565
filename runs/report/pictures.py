"""Selected pictures with their annotations: corners of the board, measured and modelled tip, backbone."""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html import escape

import numpy as np
from matplotlib import patheffects
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from runs.records import DetectionStatus
from runs.report.colours import BOARD, MEASURED, MODEL
from runs.report.drawing import PAGE_IN, narrow
from runs.report.html import plain
from runs.run import Run
from runs.summary import Summary, settled_steps

MOST_STEPS = 5
MOST_LOSSES = 2
EVENLY = 4
COLUMNS, NARROW_COLUMNS = 3, 2
NEAR_S = 0.5
"""A picture shows a moment when it was taken no farther from it."""
_MARGIN = 0.12
_LEAST_WIDTH_PX = 160

Pixels = NDArray[np.float32]


@dataclass(frozen=True)
class PictureMoment:
    """The `k`-th kept picture, and why it is shown."""

    k: int
    why: str


@dataclass(frozen=True)
class PictureSection:
    """A part of a picture: its upper left corner and its size, in pixels."""

    left: float
    top: float
    width: float
    height: float


def moments(run: Run, summary: Summary) -> tuple[PictureMoment, ...]:
    """Choose ends of steps, the largest error, and where the board was lost; evenly where a run has none of those.

    In the order of time, and with the pictures of every camera.
    """
    index = run.frames.index
    if not len(index):
        return ()
    chosen: dict[int, str] = {}
    for k, why in (*_step_ends(run, summary), *_largest_error(run), *_losses(run)):
        frame = int(index[k])
        chosen[frame] = f"{chosen[frame]}; {why}" if frame in chosen else why
    if not chosen:
        chosen = dict.fromkeys(index[np.linspace(0, len(index) - 1, EVENLY).round().astype(int)].tolist(), "")
    return tuple(
        PictureMoment(k, why) for frame, why in sorted(chosen.items()) for k in np.flatnonzero(index == frame).tolist()
    )


def view(run: Run, chosen: Iterable[PictureMoment], camera: str, size: tuple[int, int]) -> PictureSection:
    """Return the part of a camera's pictures of a size (width, height) that holds all that was seen in them."""
    of_camera = [moment.k for moment in chosen if run.frames.camera[moment.k] == camera]
    frames = run.frames
    parts = (frames.corners_px[of_camera], frames.backbone_px[of_camera])
    points = np.vstack([part.reshape(-1, 2) for part in (*parts, frames.tip_px[of_camera], frames.model_px[of_camera])])
    points = points[np.isfinite(points).all(axis=1)]
    whole_width, whole_height = size
    points = points[((points > -0.5) & (points < np.array(size) - 0.5)).all(axis=1)]
    if len(points) == 0:
        return PictureSection(0.0, 0.0, whole_width, whole_height)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    width, height = (high - low + 2 * margin).tolist()
    width = min(max(width, height * whole_width / whole_height, _LEAST_WIDTH_PX), whole_width)
    height = width * whole_height / whole_width
    centre = (low + high) / 2
    left = float(np.clip(centre[0] - width / 2, 0, whole_width - width))
    top = float(np.clip(centre[1] - height / 2, 0, whole_height - height))
    return PictureSection(left, top, width, height)


def section(run: Run, summary: Summary) -> str:
    """Return the pictures as HTML; nothing where none was kept."""
    chosen = moments(run, summary)
    if not chosen:
        return ""
    sizes = {run.frames.camera[moment.k]: size(run, moment.k) for moment in chosen}
    views = {camera: view(run, chosen, camera, whole) for camera, whole in sizes.items()}
    shown = "".join(_shown(run, moment, sizes, views) for moment in chosen)
    legend = (
        '<p class="small">Yellow rings: the corners as detected, the first one filled. Blue ring: the measured tip. '
        "Orange: the model's tip and backbone.</p>"
    )
    marked = any(np.isfinite(run.frames.corners_px[moment.k]).any() for moment in chosen)
    return f'<div class="pictures">{shown}</div>\n{legend if marked else ""}'


def grid(figure: Figure, run: Run, summary: Summary) -> None:
    """Draw the same pictures for a paper."""
    chosen = moments(run, summary)
    sizes = {run.frames.camera[moment.k]: size(run, moment.k) for moment in chosen}
    columns = min(len(chosen), NARROW_COLUMNS if narrow(figure) else COLUMNS)
    panels = figure.subplots(-(-len(chosen) // columns), columns, squeeze=False).ravel()
    for panel in panels:
        panel.set_axis_off()
    for panel, moment in zip(panels, chosen, strict=False):
        frames, k = run.frames, moment.k
        part = view(run, chosen, frames.camera[k], sizes[frames.camera[k]])
        panel.imshow(decoded(run, k), cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
        edge = [patheffects.withStroke(linewidth=2.6, foreground="white")]
        panel.plot(*frames.backbone_px[k].T, color=MODEL, lw=1.1)
        panel.plot(*frames.corners_px[k].T, "o", ms=2.2, mfc="none", mec=BOARD, mew=0.7)
        panel.plot(*frames.tip_px[k], "o", ms=7, mfc="none", mec=MEASURED, mew=1.4, path_effects=edge)
        panel.plot(*frames.model_px[k], "x", ms=5, mew=1.4, color=MODEL, path_effects=edge)
        panel.set_xlim(part.left - 0.5, part.left + part.width - 0.5)
        panel.set_ylim(part.top + part.height - 0.5, part.top - 0.5)
        panel.set_title(
            "\n".join(textwrap.wrap(caption(run, moment), 27 if narrow(figure) else 42)),
            fontsize=6.5 if narrow(figure) else 7.5,
            parse_math=False,
        )


def grid_size(run: Run, summary: Summary) -> tuple[float, float]:
    """Return the size of the figure that `grid` fills, in inches."""
    count = len(moments(run, summary))
    return PAGE_IN, 2.2 * -(-count // min(count, COLUMNS))


def decoded(run: Run, k: int) -> NDArray[np.uint8]:
    """Return the k-th kept picture (height, width) grey or (height, width, 3) RGB."""
    try:
        with Image.open(io.BytesIO(run.picture(k))) as image:
            return np.asarray(image if image.mode == "L" else image.convert("RGB"), np.uint8)
    except (OSError, SyntaxError, ValueError):  # by which Pillow reports what is no picture, or no whole one
        return np.zeros((1, 1), np.uint8)


def size(run: Run, k: int) -> tuple[int, int]:
    """Return width and height of the k-th kept picture."""
    height, width = decoded(run, k).shape[:2]
    return width, height


def caption(run: Run, moment: PictureMoment) -> str:
    """Return what a picture shows and when."""
    frames = run.frames
    when = f"{frames.time_s[moment.k]:.2f} s, frame {frames.index[moment.k]}"
    camera = f"{frames.camera[moment.k]}, " if len(set(frames.camera)) > 1 else ""
    row = row_of(run, moment.k)
    error = float(run.tip.error_mm[row]) if row is not None else float("nan")
    measured = f", error {plain(error, 2)} mm" if np.isfinite(error) else ""
    return f"{moment.why}: {camera}{when}{measured}" if moment.why else f"{camera}{when}{measured}"


def row_of(run: Run, k: int) -> int | None:
    """Return the row of the tip that belongs to the k-th kept picture."""
    row = int(np.searchsorted(run.tip.frame, run.frames.index[k]))
    return row if row < len(run.tip.frame) and run.tip.frame[row] == run.frames.index[k] else None


def _step_ends(run: Run, summary: Summary) -> Iterator[tuple[int, str]]:
    steps = settled_steps(summary.steps)
    some = np.unique(np.linspace(0, len(steps) - 1, min(len(steps), MOST_STEPS)).round().astype(int))
    rows = np.array([-1 if (row := row_of(run, k)) is None else row for k in range(len(run.frames.time_s))])
    protocol_s = np.where(rows >= 0, run.tip.protocol_s[rows], np.nan) if len(run.tip.protocol_s) else rows * np.nan
    for step in (steps[i] for i in some if len(steps)):
        within = np.flatnonzero((protocol_s >= step.start_s) & (protocol_s < step.stop_s))
        if len(within):
            yield int(within[-1]), f"end of {step.label}"


def _largest_error(run: Run) -> Iterator[tuple[int, str]]:
    if np.isfinite(run.tip.error_mm).any():
        row = int(np.nanargmax(run.tip.error_mm))
        k = int(np.abs(run.frames.time_s - run.tip.time_s[row]).argmin())
        if abs(run.frames.time_s[k] - run.tip.time_s[row]) <= NEAR_S:
            largest = plain(float(run.tip.error_mm[row]), 2)
            yield k, "largest error" if row_of(run, k) == row else f"near the largest error ({largest} mm)"


def _losses(run: Run) -> Iterator[tuple[int, str]]:
    """The first picture of the longest losses."""
    seen = run.tip.seen
    if not (seen == DetectionStatus.MEASURED).any():
        return
    lost = np.concatenate([[0], seen != DetectionStatus.MEASURED, [0]]).astype(int)
    begins, ends = np.flatnonzero(np.diff(lost) == 1), np.flatnonzero(np.diff(lost) == -1)
    found = 0
    for i in np.argsort(begins - ends, kind="stable"):
        first, last = run.tip.frame[begins[i]], run.tip.frame[ends[i] - 1]
        within = np.flatnonzero((run.frames.index >= first) & (run.frames.index <= last))
        if len(within) and found < MOST_LOSSES:
            found += 1
            why = DetectionStatus(int(seen[begins[i]])).words
            yield int(within[0]), f"nothing measured ({why})"


def _shown(run: Run, moment: PictureMoment, sizes: dict[str, tuple[int, int]], views: dict[str, PictureSection]) -> str:
    frames, k = run.frames, moment.k
    camera = frames.camera[k]
    width, height = sizes[camera]
    lost = not np.isfinite(frames.corners_px[k]).any()
    part = PictureSection(0, 0, width, height) if lost else views[camera]
    kind = "png" if frames.encoding[k] == "png" else "jpeg"
    data = base64.b64encode(run.picture(k)).decode()
    title = caption(run, moment)
    # A pixel's number is that of its middle; a drawing's begins at its edge.
    box = f"{part.left:.1f} {part.top:.1f} {part.width:.1f} {part.height:.1f}"
    return (
        f'<figure><svg viewBox="{box}" role="img" aria-label="{escape(title)}">'
        f'<image width="{width}" height="{height}" href="data:image/{kind};base64,{data}"/>'
        f'<g transform="translate(.5 .5)">{_overlay(run, k, part.width / 320)}</g></svg>'
        f"<figcaption>{escape(title)}</figcaption></figure>"
    )


def _overlay(run: Run, k: int, unit: float) -> str:
    """Return the marks of a picture as SVG, in its pixels; `unit` is the width of a thin line."""
    frames = run.frames
    parts = []
    line = frames.backbone_px[k]
    if len(line) and np.isfinite(line).all():
        parts.append(
            f'<polyline points="{_points(line)}" fill="none" stroke="{MODEL}" stroke-width="{1.6 * unit:.2f}"/>'
        )
    corners = frames.corners_px[k]
    for i in np.flatnonzero(np.isfinite(corners).all(axis=1)):
        u, v = corners[i]
        fill = BOARD if i == 0 else "none"
        parts.append(
            f'<circle cx="{u:.2f}" cy="{v:.2f}" r="{1.9 * unit:.2f}" fill="{fill}" stroke="{BOARD}" '
            f'stroke-width="{0.9 * unit:.2f}"/>'
        )
    (u, v), r = frames.tip_px[k], 6 * unit
    if np.isfinite(u + v):
        parts.append(_outlined(f'circle cx="{u:.2f}" cy="{v:.2f}" r="{r:.2f}"', MEASURED, unit))
    (u, v), r = frames.model_px[k], 4 * unit
    if np.isfinite(u + v):
        cross = f"M{u:.2f} {v:.2f}m{-r:.2f} {-r:.2f}l{2 * r:.2f} {2 * r:.2f}m0 {-2 * r:.2f}l{-2 * r:.2f} {2 * r:.2f}"
        parts.append(_outlined(f'path d="{cross}"', MODEL, unit))
    return "".join(parts)


def _outlined(shape: str, colour: str, unit: float) -> str:
    """Return a line with a white edge: it is seen on dark and on bright."""
    return "".join(
        f'<{shape} fill="none" stroke="{stroke}" stroke-width="{width * unit:.2f}"/>'
        for stroke, width in (("#fff", 3.2), (colour, 1.7))
    )


def _points(line: Pixels) -> str:
    return " ".join(f"{u:.2f},{v:.2f}" for u, v in line)
