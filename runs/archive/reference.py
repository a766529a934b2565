"""The tables of declared columns in `docs/reference/archive.md`.

`python -m runs.archive.reference docs/reference/archive.md` writes them again, each between its two marks.
"""

from __future__ import annotations

import sys
from pathlib import Path

from runs.columns import AXES, TABLES
from runs.columns.declaration import Table


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


def page(text: str) -> str:
    """Return the page with its tables as the columns are declared now.

    Raises:
        ValueError: the page has no place for a table.
    """
    for kind in TABLES:
        before, after = f"<!-- columns: {kind.group} -->\n", "<!-- end -->"
        found = text.count(before)
        if found != 1:
            raise ValueError(f"the page has {found} lines '{before.strip()}', expected 1")
        above, rest = text.split(before)
        text = above + before + table(kind) + rest[rest.index(after) :]
    return text


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(page(path.read_text(encoding="utf-8")), encoding="utf-8")
