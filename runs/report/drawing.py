"""Drawing kit of the figures: style, SVG and file output, panels with fixed margins, decimation of long lines."""

from __future__ import annotations

import io
import multiprocessing
import os
import re
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from numpy.typing import NDArray

from runs.arrays import Array
from runs.overwriting import replacing
from runs.report import figure_data
from runs.report.colours import INK, MUTED, RULE

Draw = Callable[[], str]

POINTS = 600
"""Points drawn of a long line; their extremes are kept."""

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "text.color": INK,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.3,
    "lines.solid_joinstyle": "round",
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.06,
}
_PRINT: dict[Any, Any] = {
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "pdf.fonttype": 42,
    "font.size": 8,
    "axes.titlesize": 8,
    "legend.fontsize": 7.5,
    "lines.linewidth": 1.1,
}
COLUMN_MM = 88.0
"""Usual width of a column of a journal with two."""
_NARROW_IN = 6.0
"""In a narrower figure, panels stand below each other."""
PAGE_IN = 6.9
"""Width of the figures of a page, whose heights the specifications state."""
_NARROW_LABELS_IN = 0.6
"""Width of the labels left of a narrow figure's panels."""
_NARROW_HEIGHT, _NARROW_LEGEND_IN = 0.7, 0.5
"""Height of a narrow figure's panels as a part of that on the page; height for the rows of its legend."""
_INCH_MM = 25.4
_MARGINS_IN = (0.72, 0.1, 0.46, 0.28)
"""Left, right, below and above of a figure's panels, for labels and legends; `_GAPS_IN` beside and below each."""
_GAPS_IN = (0.72, 0.3)
_LEGEND_ROW_IN = 0.18
_FONTS = "Inter, 'Helvetica Neue', Helvetica, Arial, 'DejaVu Sans', sans-serif"

_PATHS, _DIGITS = re.compile(r' d="[^"]*"'), re.compile(r"(?<=\.\d)\d+")
"""A tenth of a point is as fine as a page shows."""


@dataclass(frozen=True)
class FigureSpecification:
    """One figure at a size in inches: `draw(figure, *about)`.

    `beside` is the number of panels beside each other, which a narrow figure has below each other.
    """

    name: str
    title: str
    draw: Callable[..., None]
    size: tuple[float, float]
    caption: str = ""
    about: tuple[object, ...] = ()
    beside: int = 1

    def print_size(self, width_mm: float) -> tuple[float, float]:
        """Return the size in inches of the figure in print, at a width."""
        width = width_mm / _INCH_MM
        if width < _NARROW_IN:
            return width, _NARROW_LEGEND_IN + _NARROW_HEIGHT * self.beside * self.size[1]
        return width, max(width / PAGE_IN, _NARROW_HEIGHT) * self.size[1]


def svg(draw: Callable[..., None], size: tuple[float, float], salt: str, *about: object) -> str:
    """Return a figure of a size in inches as an SVG element (see `svg_and_data`)."""
    return svg_and_data(draw, size, salt, *about)[0]


def svg_and_data(
    draw: Callable[..., None], size: tuple[float, float], salt: str, *about: object, mark: str = ""
) -> tuple[str, str]:
    """Return a figure of a size in inches as an SVG element, and as CSV what it shows (see `figure_data`).

    `draw` is called with the figure and `about`. The `salt` keeps the drawing's ids apart from others on the page; the
    `mark` is the remark in the data.
    """
    with mpl.rc_context({**STYLE, "svg.hashsalt": f"{salt}/{getattr(draw, '__name__', '')}"}):
        figure = Figure(figsize=size)
        canvas = FigureCanvasSVG(figure)
        draw(figure, *about)
        text = io.StringIO()
        # Not figure.savefig: it draws everything twice.
        canvas.print_svg(text, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
    drawing = text.getvalue()
    drawing = _PATHS.sub(lambda path: _DIGITS.sub("", path[0]), drawing[drawing.index("<svg") :])
    return drawing.replace("'DejaVu Sans'", _FONTS), figure_data.table(figure, mark)


def load_fonts_and_layouts() -> None:
    """Draw a small figure: what later figures load when they are first drawn is then loaded."""

    def everything(figure: Figure) -> None:
        for axes in panels(figure, columns=2)[0]:
            axes.errorbar([0.0, 1.0], [0.0, 1.0], [0.1, 0.1], fmt="o", label="-1.5 [mm]")
            axes.fill_between([0.0, 1.0], [0.0, 1.0], alpha=0.2)
            axes.bar([0.0, 1.0], [0.0, 1.0])
            axes.annotate("0", (0, 0))
            axes.set_xlabel("x [mm]")
            axes.set_ylabel("z [mm]")
            legend(axes)
        figure.colorbar(ScalarMappable(Normalize(0.0, 1.0), "viridis"), ax=axes, label="pressure [bar]")

    svg(everything, (6.0, 3.0), "")


def save(draw: Callable[..., None], size: tuple[float, float], path: Path, *about: object, mark: str = "") -> None:
    """Write a figure of a size in inches to a file for print; the file's kind is that of its name.

    `draw` is called with the figure and `about`. A CSV file beside it has what is drawn (see `figure_data`). The
    `mark` goes into a corner: a remark for a figure that is shown without its page.
    """
    with mpl.rc_context(STYLE | _PRINT):
        figure = Figure(figsize=size)
        draw(figure, *about)
        if mark:
            # Below the axis labels, whatever their size.
            figure.supxlabel(mark, x=0.995, ha="right", va="bottom", fontsize=6.5, color=MUTED)
        with replacing(path) as part:
            figure.savefig(part, dpi=300, format=path.suffix[1:])
    figure_data.write(figure, path.with_suffix(".csv"), mark)


def narrow(figure: Figure) -> bool:
    """Return whether panels stand below each other in a figure of this width."""
    return bool(figure.get_size_inches()[0] < _NARROW_IN)


def panels(figure: Figure, rows: int = 1, columns: int = 1, *, legend_rows: int = 1, **options: Any) -> NDArray[Any]:
    """Return axes (rows, columns); in a narrow figure the columns of a row stand below each other.

    On the page the spacing round them is fixed: to measure every label takes as long as to draw.
    """
    if narrow(figure):
        return _stacked(figure, rows, columns, **options)
    figure.set_layout_engine("none")
    width, height = figure.get_size_inches()
    left, right, below, above = _MARGINS_IN
    beside, between = _GAPS_IN
    above += (legend_rows - 1) * _LEGEND_ROW_IN
    across = (width - left - right - (columns - 1) * beside) / columns
    down = (height - below - above - (rows - 1) * between) / rows
    spacing = {
        "left": left / width,
        "right": 1 - right / width,
        "bottom": below / height,
        "top": 1 - above / height,
        "wspace": beside / across,
        "hspace": between / down,
    }
    axes: NDArray[Any] = figure.subplots(
        rows, columns, sharex=columns == 1, squeeze=False, gridspec_kw=spacing, **options
    )
    return axes


def _stacked(figure: Figure, rows: int, columns: int, **options: Any) -> NDArray[Any]:
    options.pop("width_ratios", None)
    if columns > 1:
        options.pop("height_ratios", None)
    stacked = figure.subplots(rows * columns, 1, sharex=columns == 1, squeeze=False, **options)
    axes: NDArray[Any] = stacked.reshape(rows, columns)
    return axes


def decimated(x: Array, y: Array) -> tuple[Array, Array]:
    """Return a line with fewer points that looks the same: the extremes of each stretch."""
    index = decimated_indices(y)
    return x[index], y[index]


def path_indices(points: Array) -> NDArray[np.intp]:
    """Return which points (n, d) of a path are drawn: evenly chosen ones, and every gap."""
    chosen: NDArray[np.bool_] = np.asarray(~np.isfinite(points).all(axis=1))
    chosen[:: max(len(points) // (4 * POINTS), 1)] = True
    return np.flatnonzero(chosen)


def decimated_indices(y: Array) -> NDArray[np.intp]:
    """Return which points of a line are drawn: all of a short one, else the extremes and a gap of each stretch."""
    stretch = len(y) // POINTS * 2
    if stretch < 4:
        return np.arange(len(y))
    whole = len(y) // stretch * stretch
    blocks = y[:whole].reshape(-1, stretch)
    first = np.arange(0, whole, stretch)
    lowest = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    highest = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    # Where nothing is missing this is the first point again.
    missing = np.isnan(blocks).argmax(axis=1)
    return np.append(np.unique(np.column_stack((first, first + lowest, first + highest, first + missing))), len(y) - 1)


def legend(axes: Axes, columns: int = 6) -> None:
    """Above the plot, so that it never hides a line; none where nothing has a name."""
    if not axes.get_legend_handles_labels()[0]:
        return
    figure = axes.get_figure(root=True)
    assert figure is not None
    names = _legend(axes, columns)
    while columns > 1 and _overflows(names, axes, figure):
        columns -= 1
        names = _legend(axes, columns)
    for name in names.get_texts():
        name.set_parse_math(False)  # a dollar in the name of a run begins no formula


def _legend(axes: Axes, columns: int) -> Legend:
    # More columns than usual must share the width: the spacing above is that of one row.
    beside = 1.4 * min(1.0, 6 / columns) ** 2
    return axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        columnspacing=beside,
        handlelength=2.0 * min(1.0, 6 / columns),
    )


def _renderer(figure: Figure) -> RendererAgg:
    renderer: RendererAgg = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    return renderer


def _overflows(names: Legend, axes: Axes, figure: Figure) -> bool:
    width = names.get_window_extent(_renderer(figure)).width
    return bool(width > figure.bbox.width - _NARROW_LABELS_IN * figure.dpi)


def no_data(*panels: Axes) -> None:
    """Write 'nothing was recorded' into empty panels."""
    for panel in panels:
        panel.annotate("nothing was recorded", (0.5, 0.5), xycoords="axes fraction", ha="center", color=MUTED)


def drawn(figures: Sequence[Draw]) -> list[str]:
    """Return the results of functions that draw a figure, in their order; a second processor draws every other one.

    The child is forked, so that it has what the figures show. If it fails, this process draws its part, too, and
    raises the error.
    """
    # Windows cannot fork, and on macOS a forked process must not draw; neither has this function.
    if len(figures) < 2 or not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2:
        return [draw() for draw in figures]
    fork = multiprocessing.get_context("fork")
    received, sent = fork.Pipe(duplex=False)
    child = fork.Process(target=_draw, args=(figures[1::2], sent), daemon=True)
    with warnings.catch_warnings():
        # Python warns of every fork beside other threads; no figure waits for one.
        warnings.simplefilter("ignore", DeprecationWarning)
        child.start()
    sent.close()
    try:
        even, odd = [draw() for draw in figures[::2]], []
        with suppress(EOFError, OSError):
            odd = received.recv()
    finally:
        child.kill()
        child.join()
        received.close()
    odd = odd or [draw() for draw in figures[1::2]]
    return [drawing for pair in zip_longest(even, odd) for drawing in pair if drawing is not None]


def _draw(figures: Sequence[Draw], results: Connection) -> None:
    with suppress(Exception):
        results.send([draw() for draw in figures])
