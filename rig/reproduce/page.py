"""Write the comparison: a self-contained page, and each figure as PNG and PDF."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from rig.reproduce.comparison import PaperComparison
from runs.overwriting import staged
from runs.report import html
from runs.report.drawing import FigureSpecification, save
from runs.report.html import html_document, html_table

_STYLE = (
    "table.paper td, table.paper th { vertical-align: top; } table.paper td:nth-child(6) { min-width: 18em; } "
    "table.paper td:first-child { white-space: nowrap; }"
)
_LONG = "Table 4"
_MARK = '<meta name="softrig-reproduce" content="paper">'


def write(
    folder: Path,
    rows: Sequence[PaperComparison],
    drawings: Sequence[FigureSpecification],
    remarks: Sequence[str],
    *,
    replace: bool = False,
) -> Path:
    """Write `paper.html` and the figures; return the page. A folder that has such a page is written again.

    Raises:
        WouldOverwriteError: a file exists in another folder, and `replace` is False.
        OSError: a file cannot be written.
    """
    page = folder / "paper.html"
    ours = page.is_file() and _MARK in page.read_text(encoding="utf-8", errors="replace")
    with staged(folder, replace=replace, made=lambda _: ours) as stage:
        for drawing in drawings:
            for kind in ("png", "pdf"):
                save(drawing.draw, drawing.size, stage / f"{drawing.name}.{kind}", *drawing.about)
        (stage / page.name).write_text(_page(rows, drawings, remarks), encoding="utf-8")
    return page


def _page(rows: Sequence[PaperComparison], drawings: Sequence[FigureSpecification], remarks: Sequence[str]) -> str:
    figures = html.figures(html.figure(drawing, drawing.name) for drawing in drawings)
    simulated = any(row.origin == "simulated" for row in rows)
    note = (
        '<p class="note"><b>Lines marked <i>simulated</i> are of the mock rig.</b> They show that the experiment and '
        "its evaluation work; they are no measurement of the paper's arm.</p>"
        if simulated
        else ""
    )
    paragraphs = "".join(f"<p>{escape(remark)}</p>" for remark in remarks)
    body = (
        "<section class=run>\n"
        "<header class=run><h1>The paper again</h1><p class=sub>Pourghasemi Hanza and Ghafarirad, Mechanics of fiber "
        "reinforced soft manipulators based on inhomogeneous Cosserat rod theory, section by section</p></header>\n"
        f"{note}\n<h2>Side by side</h2>\n{_table(rows)}\n{paragraphs}\n{figures}\n</section>"
    )
    return html_document("The paper again", f"{_MARK}\n<style>{_STYLE}</style>", body)


def _table(rows: Sequence[PaperComparison]) -> str:
    cells = (
        [*map(escape, (row.item, row.what, row.paper, row.computed, row.origin, row.why))]
        for row in sorted(rows, key=lambda row: row.item == _LONG)  # its many lines would hide the others
    )
    return html_table(("item", "what", "paper", "here", "by", "why different"), cells, kind="paper")
