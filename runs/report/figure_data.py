"""What a figure shows, as CSV: lines, error bars, bars and bands of its panels."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from runs.overwriting import write_text
from runs.printable_text import printable

DIGITS = 7
"""Significant digits of a number: a figure shows four."""
Drawn = tuple[str, str, tuple[ArrayLike, ...]]
"""Kind, label and columns: x and y, and the low and high ends where there are some."""


def table(figure: Figure, remark: str = "") -> str:
    """Return the data of a drawn figure as CSV: two columns for each curve, x and y, beside each other.

    The name of a column holds panel, kind and number of the curve in its panel, its label, and the axis with its unit.
    An error bar, or a horizontal bar, has two more columns with its ends. The points of a `band` are those of its
    outline. The last column, `remark`, is that of the figure's corner, such as `simulated`.
    """
    columns: dict[str, list[str]] = {}
    for panel, axes in enumerate(figure.axes, 1):
        labels = (printable(_x_label(axes)) or "x", printable(axes.get_ylabel().replace("\n", " ")) or "y")
        counted: dict[str, int] = {}
        for kind, label, values in _drawn(axes):
            counted[kind] = counted.get(kind, 0) + 1
            named = "" if label.startswith("_") else f" ({printable(label)})"
            curve = f"panel {panel} {kind} {counted[kind]}{named}: "
            for name, column in zip((*labels, "low", "high"), values, strict=False):
                columns[curve + name] = _numbers(column)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*columns, "remark"])
    writer.writerows([*row, remark] for row in zip_longest(*columns.values(), fillvalue=""))
    return out.getvalue()


def write(figure: Figure, path: Path, remark: str = "") -> None:
    """Write the data of a drawn figure as CSV (see `table`)."""
    write_text(path, table(figure, remark))


def _numbers(column: ArrayLike) -> list[str]:
    """Return numbers as text; empty where there is none, as in the gaps of a line."""
    values = np.asarray(column, float)
    return [f"{value:.{DIGITS}g}" if known else "" for value, known in zip(values, np.isfinite(values), strict=True)]


def _x_label(axes: Axes) -> str:
    """Return the label of the x axis; of panels below each other that share the axis, only the lowest shows it."""
    together = (axes, *axes.get_shared_x_axes().get_siblings(axes))
    return next((label for one in together if (label := one.get_xlabel())), "")


def _drawn(axes: Axes) -> Iterator[Drawn]:
    """Yield everything in a panel that shows data."""
    parts = set()
    for container in axes.containers:
        if isinstance(container, ErrorbarContainer):
            line, caps, bars = container.lines
            parts |= {line, *caps}
            ends = np.array([segment[:, 1] for segment in bars[0].get_segments()]).reshape(-1, 2).T if bars else ()
            yield "error bar", str(container.get_label()), (*line.get_data(), *ends)
        elif isinstance(container, BarContainer):
            yield "bar", str(container.get_label()), _bars(container)
    for line in axes.get_lines():
        if line not in parts:
            yield "line", str(line.get_label()), tuple(np.broadcast_arrays(*line.get_data()))
    for band in axes.collections:
        if isinstance(band, PolyCollection):
            outline = [np.asarray(path.vertices) for path in band.get_paths()]
            yield "band", str(band.get_label()), tuple(np.vstack(outline).T) if outline else ()


def _bars(bars: BarContainer) -> tuple[NDArray[Any], ...]:
    """Return for each bar its middle and length; of a horizontal one also its edges across."""
    boxes = np.array([(bar.get_x(), bar.get_y(), bar.get_width(), bar.get_height()) for bar in bars]).reshape(-1, 4)
    x, y, wide, high = boxes.T
    if bars.orientation == "horizontal":
        return wide, y + high / 2, np.minimum(y, y + high), np.maximum(y, y + high)
    return x + wide / 2, high
