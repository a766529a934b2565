"""What a figure shows, as CSV: lines, error bars, bars and bands of its panels."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.figure import Figure

from runs.overwriting import replacing
from runs.printable_text import printable

COLUMNS = ("panel", "kind", "number", "label", "x_label", "y_label", "x", "y", "low", "high", "remark")
Points = Iterator[tuple[float, float, Any, Any]]


def write(figure: Figure, path: Path, remark: str = "") -> None:
    """Write the data of a drawn figure as CSV, one point a row.

    `panel` and `number` count panels, and what has one `kind` in a panel. `low` and `high` are the ends of a vertical
    error bar or of a bar, empty elsewhere. The points of a `band` are those of its outline. `remark` is that of
    the figure's corner, such as `simulated`.
    """
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for panel, axes in enumerate(figure.axes, 1):
            labels = (printable(_x_label(axes)), printable(axes.get_ylabel().replace("\n", " ")))
            counted: dict[str, int] = {}
            for kind, label, points in _drawn(axes):
                counted[kind] = counted.get(kind, 0) + 1
                named = "" if label.startswith("_") else printable(label)
                writer.writerows((panel, kind, counted[kind], named, *labels, *point, remark) for point in points)


def _x_label(axes: Axes) -> str:
    """Return the label of the x axis; of panels below each other that share the axis, only the lowest shows it."""
    together = (axes, *axes.get_shared_x_axes().get_siblings(axes))
    return next((label for one in together if (label := one.get_xlabel())), "")


def _drawn(axes: Axes) -> Iterator[tuple[str, str, Points]]:
    """Yield kind, label and points of everything in a panel that shows data."""
    parts = set()
    for container in axes.containers:
        if isinstance(container, ErrorbarContainer):
            line, caps, bars = container.lines
            parts |= {line, *caps}
            ends = [segment[:, 1] for segment in bars[0].get_segments()] if bars else []
            yield "error bar", str(container.get_label()), _with_ends(*line.get_data(), ends)
        elif isinstance(container, BarContainer):
            yield "bar", str(container.get_label()), _bars(container)
    for line in axes.get_lines():
        if line not in parts:
            points = zip(*np.broadcast_arrays(*line.get_data()), strict=True)
            yield "line", str(line.get_label()), ((x, y, "", "") for x, y in points)
    for band in axes.collections:
        if isinstance(band, PolyCollection):
            outline = (path.vertices for path in band.get_paths())
            yield "band", str(band.get_label()), ((x, y, "", "") for part in outline for x, y in np.asarray(part))


def _with_ends(x: Any, y: Any, ends: list[Any]) -> Points:
    for k, (at, value) in enumerate(zip(x, y, strict=True)):
        yield at, value, *(ends[k] if k < len(ends) else ("", ""))


def _bars(bars: BarContainer) -> Points:
    """Yield for each bar its middle and length; `low` and `high` are its edges across."""
    for bar in bars:
        if bars.orientation == "horizontal":
            low, high = sorted((bar.get_y(), bar.get_y() + bar.get_height()))
            yield bar.get_width(), (low + high) / 2, low, high
        else:
            yield bar.get_x() + bar.get_width() / 2, bar.get_height(), "", ""
