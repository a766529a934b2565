"""A board to print: the page at its true size, with a ruler that shows whether the printer kept it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from model.arrays import Array
from protocols import arguments
from protocols.problems import bad_input, raise_all
from rig.config.board_sections import BoardPattern
from runs.overwriting import replacing

if TYPE_CHECKING:
    from calibration.vision.board import PrintedCells


FORMATS = (".pdf", ".svg")
"""Formats that keep a length; the size of a bitmap is the printer's choice."""
_MM_PER_INCH = 25.4
_PAGES_MM = {"A4": (210.0, 297.0), "A4 landscape": (297.0, 210.0), "A3": (297.0, 420.0), "A3 landscape": (420.0, 297.0)}
_BORDER_MM = 12.0
# Above the board: the texts; below it: the ruler.
_HEAD_MM, _FOOT_MM = 24.0, 16.0
_RULER_MM = 100
_TEXT_PT = 8.0
_GREY = "0.6"


@dataclass(frozen=True)
class BoardPage:
    """The board on its page [mm]: the page's size, and top left corner and size of the print."""

    page: str
    size_mm: tuple[float, float]
    origin_mm: tuple[float, float]
    print_mm: tuple[float, float]


def page_of(section: BoardPattern) -> BoardPage:
    """The smallest page that holds the board with its white margin; one of its own size beyond A3."""
    board = section.board()
    unit_mm, margin = 1e3 * board.unit_m, board.printed.margin
    width, height = (extent * unit_mm for extent in board.extent)
    rim = margin * unit_mm
    needs = (max(width + 2 * rim, _RULER_MM) + 2 * _BORDER_MM, height + 2 * rim + _HEAD_MM + _FOOT_MM + 2 * _BORDER_MM)
    fits = (name for name, size in _PAGES_MM.items() if needs[0] <= size[0] and needs[1] <= size[1])
    page = next(fits, "page of its own size")
    size = _PAGES_MM.get(page, needs)
    left = (size[0] - width) / 2
    return BoardPage(page, size, (left, _BORDER_MM + _HEAD_MM + rim), (width, height))


def texts(section: BoardPattern, page: BoardPage, name: str) -> tuple[str, ...]:
    """The text above the board."""
    width, height = page.print_mm
    lengths = ", ".join(f"{of} {value:g} mm" for of, value in section.lengths_mm.items())
    return (
        f"{section.board().description} (rig {name})",
        f"{lengths}; print {width:g} x {height:g} mm",
        *section.marker_texts,
        f"Print at 100 % on {page.page}; then the ruler is {_RULER_MM} mm long. Keep the white to the grey line.",
    )


def write(section: BoardPattern, name: str, path: Path) -> BoardPage:
    """Write the page of the board of rig `name` as PDF or SVG."""
    import matplotlib
    from matplotlib.figure import Figure

    if not isinstance(section, BoardPattern):
        raise bad_input("board", arguments.shown(section), "the board of a rig, as rig.open(..).config.board")
    raise_all(arguments.text_problems({"rig": name}))
    path = arguments.path("--to", path)
    page = page_of(section)
    figure = Figure(figsize=(page.size_mm[0] / _MM_PER_INCH, page.size_mm[1] / _MM_PER_INCH), facecolor="white")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0, page.size_mm[0])
    axes.set_ylim(page.size_mm[1], 0)
    board = section.board()
    _print(axes, board.printed, page, 1e3 * board.unit_m)
    _ruler(axes, page)
    for k, line in enumerate(texts(section, page, name)):
        axes.text(_BORDER_MM, _BORDER_MM + 5 * k, line, fontsize=_TEXT_PT, va="top")
    # Text stays text, and two files of one board are equal.
    with (
        replacing(path) as part,
        matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "pdf.fonttype": 42}),
    ):
        ending = path.suffix.lower()[1:]
        dated = "Date" if ending == "svg" else "CreationDate"
        figure.savefig(part, format=ending, metadata={dated: None})
    return page


def dark_rectangles(printed: PrintedCells) -> Array:
    """Left, top, right and bottom (n, 4) in units of the dark cells, those beside each other in a row as one."""
    found = []
    for i, row in enumerate(printed.dark):
        changes = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        for first, end in changes.reshape(-1, 2):
            found.append((printed.across[first], printed.down[i], printed.across[end], printed.down[i + 1]))
    return np.array(found, dtype=np.float64).reshape(-1, 4)


def _print(axes: Any, printed: PrintedCells, page: BoardPage, unit_mm: float) -> None:
    from matplotlib.patches import PathPatch, Rectangle
    from matplotlib.path import Path as Outline

    left, top = page.origin_mm
    rectangles = dark_rectangles(printed) * unit_mm + np.array([left, top, left, top])
    corners = rectangles[:, [0, 1, 2, 1, 2, 3, 0, 3, 0, 1]].reshape(-1, 2)
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY] * len(rectangles)
    # One path: cells of their own would leave hairlines between them.
    axes.add_patch(PathPatch(Outline(corners, codes), facecolor="black", linewidth=0, gid="print"))
    rim = printed.margin * unit_mm
    width, height = (length + 2 * rim for length in page.print_mm)
    axes.add_patch(Rectangle((left - rim, top - rim), width, height, fill=False, edgecolor=_GREY, linewidth=0.3))


def _ruler(axes: Any, page: BoardPage) -> None:
    left, bottom = (page.size_mm[0] - _RULER_MM) / 2, page.size_mm[1] - _BORDER_MM - 4
    axes.plot([left, left + _RULER_MM], [bottom, bottom], color="black", linewidth=0.5, gid="ruler")
    for k in range(_RULER_MM + 1):
        length = 4.0 if k % 10 == 0 else 2.5 if k % 5 == 0 else 1.5
        axes.plot([left + k] * 2, [bottom, bottom - length], color="black", linewidth=0.3, solid_capstyle="butt")
        if k % 10 == 0:
            label = f"{k} mm" if k == _RULER_MM else str(k)
            axes.text(left + k, bottom + 1, label, fontsize=_TEXT_PT - 1, ha="center", va="top")
