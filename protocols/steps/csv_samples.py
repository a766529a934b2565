"""Columns of numbers from a CSV file, over time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from protocols.document import read_text
from protocols.problems import BadInputError, Problem, closest, raise_all
from protocols.source_positions import shortened
from protocols.steps.base import LONGEST_S

LARGEST_FILE = 20_000_000
MOST_PROBLEMS = 20
TIME = "time_s"


Columns = tuple[tuple[float, ...], ...]
"""Columns of numbers (n,), in the order in which they were asked for."""
Bounds = Mapping[str, tuple[float, float, str]]
"""Lowest and highest value of a column, and its unit, by the column's name."""


def read_columns(path: Path, columns: Bounds, *, timed: bool = True) -> tuple[Columns, str]:
    """Columns of a CSV file and its text; `timed`: first the ascending times [s], which count from the first row.

    Raises:
        BadInputError: line and column of everything that is wrong.
    """
    wanted = {TIME: (-LONGEST_S, LONGEST_S, "s"), **columns} if timed else dict(columns)
    text = read_text(path, LARGEST_FILE)
    rows = text.split("\n")
    if not rows[0].strip():
        raise BadInputError([Problem(str(path), 1, 1, "", "nothing", _header_wish(wanted))])
    if not timed and TIME in _cells(rows[0]):
        expected = f"no column {TIME}, or a step without a speed: only one of them can set the times"
        raise BadInputError([Problem(str(path), 1, rows[0].index(TIME) + 1, "", TIME, expected)])
    places = _header(path, rows[0], tuple(wanted))
    width = len(_cells(rows[0]))
    table: list[list[float]] = []
    problems: list[Problem] = []
    for number, row in enumerate(rows[1:], start=2):
        if not row.strip():
            continue
        values = _row(path, number, row, places, wanted, problems)
        if len(_cells(row)) > width:
            problems.append(_surplus(path, number, row, width))
            values = None
        if timed and values is not None and table and values[0] <= table[-1][0]:
            problems.append(
                Problem(
                    str(path), number, 1, TIME, f"{values[0]:g}", f"a time after {table[-1][0]:g} s, the row before"
                )
            )
        if values is not None:
            table.append(values)
        if len(problems) >= MOST_PROBLEMS:
            break
    if not problems and len(table) < 2:
        problems.append(Problem(str(path), 0, 0, "", "", "the file needs two rows of numbers at least"))
    raise_all(problems)
    found: Columns = tuple(zip(*table, strict=True))
    if timed:
        times = found[0]
        found = (tuple(t - times[0] for t in times), *found[1:])
    return found, text


def _header_wish(wanted: Iterable[str]) -> str:
    return "a first line such as " + ",".join(wanted)


def _header(path: Path, row: str, wanted: tuple[str, ...]) -> dict[str, int]:
    """Index of each requested column."""
    names = _cells(row)
    other = next((separator for separator in ";\t" if separator in row and "," not in row), "")
    if other:
        separators = "semicolons" if other == ";" else "tabs"
        wish = "columns separated by commas, and points in decimal numbers"
        raise BadInputError(
            [Problem(str(path), 1, row.index(other) + 1, "", f"columns separated by {separators}", wish)]
        )
    problems = []
    for name in wanted:
        if names.count(name) == 1:
            continue
        meant = closest(name, [n for n in names if n not in wanted])
        column = row.rindex(name) + 1 if name in names else row.index(meant) + 1 if meant else 1
        found = f"two columns '{name}'" if name in names else f"the column '{meant}'" if meant else shortened(row)
        problems.append(Problem(str(path), 1, column, "", found, f"one column '{name}'"))
    raise_all(problems)
    return {name: names.index(name) for name in wanted}


def _row(
    path: Path, line: int, row: str, places: dict[str, int], wanted: Bounds, problems: list[Problem]
) -> list[float] | None:
    cells = _cells(row)
    values = []
    for name, place in places.items():
        if place >= len(cells):
            problems.append(Problem(str(path), line, len(row) + 1, name, "the end of the row", "a number here"))
            return None
        cell = cells[place]
        column = sum(len(before) + 1 for before in row.split(",")[:place]) + 1
        low, high, unit = wanted[name]
        try:
            value = math.nan if "_" in cell else float(cell)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            expected = "a number of seconds" if name == TIME else f"a number from {low:g} to {high:g} ({unit})"
            problems.append(Problem(str(path), line, column, name, shortened(cell) or "nothing", expected))
            return None
        values.append(value)
    return values


def _surplus(path: Path, line: int, row: str, width: int) -> Problem:
    """A row that is longer than the header, as one with decimal commas is."""
    column = sum(len(cell) + 1 for cell in row.split(",")[:width]) + 1
    expected = f"{width} numbers as in the first line, separated by commas and with decimal points"
    return Problem(str(path), line, column, "", f"{len(_cells(row))} numbers", expected)


def _cells(row: str) -> list[str]:
    return [cell.strip().strip('"') for cell in row.split(",")]
