"""Elements of a page of reports: document, notes, figures with their data, tables, and the numbers in them."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from urllib.parse import quote

from runs.printable_text import printable
from runs.report import colours
from runs.report.drawing import FigureSpecification, svg_and_data

_POINTS_PER_IN = 72
_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_VARIABLES = {value.lower(): f"var(--{name})" for name, (value, _) in colours.ON_PAGE.items()}


def html_document(title: str, head: str, body: str) -> str:
    """Return an HTML page in the style of the reports; `head` is put into its head, all arguments are HTML.

    Control characters and marks of direction, as a title may hold, are shown as their escapes.
    """
    style = resources.files("runs.report").joinpath("report.css").read_text(encoding="utf-8")
    light, dark = (" ".join(f"--{name}: {pair[form]};" for name, pair in colours.ON_PAGE.items()) for form in (0, 1))
    return printable(
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n{head}\n<title>{title}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>\n'
        f":root {{ {light} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n"
        f"{style}</style>\n"
        f"</head>\n<body>\n{body}\n<footer>Made by softrig; nothing in this page is loaded from elsewhere."
        "</footer>\n</body>\n</html>\n"
    )


def heading(title: str, beneath: str, *, simulated: bool, badges: str = "") -> str:
    """Return the head of a page; title, line beneath and badges are HTML. What was simulated is marked."""
    mark = '<span class="badge simulated">simulated</span>' if simulated else ""
    below = f'\n<p class="sub">{beneath}</p>' if beneath else ""
    return f'<header class="run"><h1>{title}{badges}{mark}</h1>{below}</header>'


def note(text: str, kind: str = "") -> str:
    """Return a remark in a frame."""
    return f'<p class="{f"note {kind}".strip()}">{text}</p>'


def small(text: str) -> str:
    """Return an explanation below a table."""
    return f"<p class=small>{text}</p>"


def folded(title: str, body: str) -> str:
    """Return what a reader may open; empty without a body."""
    return f"<details><summary>{title}</summary>\n{body}\n</details>" if body else ""


def tiles(numbers: Sequence[tuple[str, str]]) -> str:
    """Return the numbers that stand out, each with a name that stands alone; unknown ones are left out."""
    shown = (f'<div class="tile"><b>{v}</b><span>{name}</span></div>' for v, name in numbers if DASH not in v)
    body = "".join(shown)
    return f'<div class="tiles">{body}</div>' if body else ""


def figure(specification: FigureSpecification, file: str, mark: str = "") -> str:
    """Draw a figure for a page, with itself as SVG and its data as CSV to save.

    `file` names the two files, and keeps the ids of the drawing apart from others on the page. `mark` is the remark in
    the data, such as `simulated`.
    """
    drawing, data = svg_and_data(specification.draw, specification.size, file, *specification.about, mark=mark)
    title, name = escape(specification.title), escape(file)
    shown = _COLOUR.sub(lambda found: _VARIABLES.get(found[0], found[0]), drawing)
    shown = shown.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)
    encoded = base64.b64encode(_marked(drawing, specification.size, mark).encode()).decode()
    rows = quote(data, safe=",:;()[]/")
    links = (
        f'<span class="links"><a download="{name}.svg" href="data:image/svg+xml;base64,{encoded}">SVG</a> '
        f'<a download="{name}.csv" href="data:text/csv;charset=utf-8,{rows}">data (CSV)</a></span>'
    )
    caption = f"{specification.caption} " if specification.caption else ""
    return f'<figure class="drawn"><h2>{title}</h2>{shown}<figcaption>{caption}{links}</figcaption></figure>'


def _marked(drawing: str, size: tuple[float, float], mark: str) -> str:
    """Return an SVG element with a remark in its lower right corner: it is shown without its page."""
    if not mark:
        return drawing
    x, y = (_POINTS_PER_IN * length - 3 for length in size)
    style = f"font: 6.5px sans-serif; fill: {colours.MUTED}; text-anchor: end"
    return drawing.replace("</svg>", f'<text x="{x:g}" y="{y:g}" style="{style}">{escape(mark)}</text>\n</svg>')


def figures(drawn: Iterable[str]) -> str:
    """Return drawn figures beside each other where the page is wide enough; empty without one."""
    body = "\n".join(drawn)
    return f'<div class="figures">\n{body}\n</div>' if body else ""


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]], words: int | None = None, kind: str = "") -> str:
    """Return a table that scrolls where the page is narrow; empty without rows. Heads and cells are HTML.

    The first `words` columns are text (by default all), the others numbers; `kind` is the class of the table. Without
    heads, the first cell of a row is its name.
    """
    numbers = len(heads) if words is None else words

    def row(cells: Sequence[str], tag: str) -> str:
        tags = ("th" if k == 0 and not heads else tag for k in range(len(cells)))
        marked = (
            f"<{t}{' class=n' if heads and k >= numbers else ''}>{cell}</{t}>"
            for k, (t, cell) in enumerate(zip(tags, cells, strict=True))
        )
        return f"<tr>{''.join(marked)}</tr>"

    body = "".join(row(cells, "td") for cells in rows)
    style = f' class="{kind}"' if kind else ""
    head = row(heads, "th") if heads else ""
    return f'<div class="scroll"><table{style}>{head}{body}</table></div>' if body else ""


DASH = "–"
MOST_LISTED = 12
"""Numbers that a list shows."""


def plain(value: float, digits: int) -> str:
    """Return a number with a real minus, none before zero, and a dash for what is not known."""
    if math.isinf(value):
        return "never"
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}") if math.isfinite(value) else DASH


def significant(value: float, digits: int) -> str:
    """Return a number with so many significant digits, and a dash for what is not known."""
    return f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}") if math.isfinite(value) else DASH


def with_unit(value: float, unit: str, digits: int) -> str:
    """Return a number and its unit."""
    return f"{plain(value, digits)} <small>{unit}</small>" if not math.isinf(value) else "never"


def listed(values: Sequence[float], digits: int) -> str:
    """Return the first numbers of a list."""
    return ", ".join(plain(value, digits) for value in values[:MOST_LISTED]) + (
        " .." if len(values) > MOST_LISTED else ""
    )


def three(values: tuple[float, float, float], digits: int) -> str:
    """Return a vector, one dash where it is not known."""
    return "&ensp;".join(plain(value, digits) for value in values) if math.isfinite(values[0]) else DASH
