"""The tables of declared columns in `docs/reference/archive.md`, and the layouts that are read.

`python -m runs.archive.reference docs/reference/archive.md` writes them again, each between its two marks.
"""

from __future__ import annotations

import sys
from pathlib import Path

from runs.archive import layout
from runs.columns import AXES, TABLES
from runs.columns.declaration import OLDEST_LAYOUT, Table


def table(kind: type[Table]) -> str:
    """Return the columns of a table, then their scales, as Markdown."""
    lines = ["| field | size | unit | meaning |", "|---|---|---|---|"]
    for column in kind.columns():
        size = ", ".join((kind.rows, *(AXES[axis][0] for axis in column.axes)))
        unit = f" {column.unit} " if column.unit else " "
        lines.append(f"| {column.dataset} | {size} |{unit}| {column.about} |")
    for axis in dict.fromkeys(axis for column in kind.columns() for axis in column.axes):
        size, about = AXES[axis]
        lines.append(f"| {axis} | {size} | | {about} |")
    return "\n".join(lines) + "\n"


def layouts() -> str:
    """Return the sentence on the layouts that are written and read."""
    newest = layout.VERSION
    read = "other layout" if newest == OLDEST_LAYOUT else f"layout but {OLDEST_LAYOUT} to {newest}"
    return f"`layout_version` is {newest}; a reader refuses every {read}.\n"


def page(text: str) -> str:
    """Return the page with its tables as the columns are declared now.

    Raises:
        ValueError: the page has no place for a table.
    """
    parts = {f"columns: {kind.group}": table(kind) for kind in TABLES} | {"layouts": layouts()}
    for name, part in parts.items():
        before, after = f"<!-- {name} -->\n", "<!-- end -->"
        found = text.count(before)
        if found != 1:
            raise ValueError(f"the page has {found} lines '{before.strip()}', expected 1")
        above, rest = text.split(before)
        text = above + before + part + rest[rest.index(after) :]
    return text


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(page(path.read_text(encoding="utf-8")), encoding="utf-8")
