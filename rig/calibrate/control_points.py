"""Control points from a CSV: point, X_mm, Y_mm, Z_mm, camera, u_px, v_px; one row for each point that a camera saw."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.cross_validation import PointObservations
from protocols import BadInputError, Problem, document
from protocols.problems import bad_input, closest, raise_all

Floats = NDArray[np.float64]

COLUMNS = ("point", "X_mm", "Y_mm", "Z_mm", "camera", "u_px", "v_px")
LARGEST = 20_000_000
_MOST_PROBLEMS = 40


def read(path: Path) -> dict[str, PointObservations]:
    """Control points by camera, without its lens; `BadInput` with every cell that cannot be."""
    rows = table(path, COLUMNS)
    problems: list[Problem] = []
    known: dict[str, tuple[float, ...]] = {}
    found: dict[str, dict[str, tuple[tuple[float, ...], tuple[float, ...]]]] = {}
    for line, row in rows:
        place = tuple(number(path, line, name, row[name], problems) for name in COLUMNS[1:4])
        pixel = tuple(number(path, line, name, row[name], problems) for name in COLUMNS[5:])
        point, camera = row["point"], row["camera"]
        problems += [
            Problem(str(path), line, 0, name, "", "is missing: a name or a number")
            for name in ("point", "camera")
            if not row[name]
        ]
        if known.setdefault(point, place) != place:
            conflict = ", ".join(f"{x:g}" for x in known[point])
            problems.append(
                Problem(str(path), line, 0, "X_mm, Y_mm, Z_mm", ", ".join(f"{x:g}" for x in place),
                        f"{conflict}, as in an earlier row of point {point}")
            )  # fmt: skip
        if point in found.setdefault(camera, {}):
            problems.append(Problem(str(path), line, 0, "point", point, f"each point once for camera {camera}"))
        found[camera][point] = place, pixel
    raise_all(problems[:_MOST_PROBLEMS])
    return {
        camera: PointObservations(
            tuple(points),
            np.array([place for place, _ in points.values()]) * 1e-3,
            np.array([pixel for _, pixel in points.values()]),
        )
        for camera, points in found.items()
    }


def table(path: Path, columns: tuple[str, ...]) -> list[tuple[int, dict[str, str]]]:
    """Rows of a CSV by line, each with the named columns; `BadInput` where one is missing or there are no rows."""
    reader = csv.reader(document.read_text(path, LARGEST).splitlines())
    try:
        rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
    except csv.Error as fault:
        expected = f"a line of CSV ({fault})"
        raise BadInputError([Problem(str(path), reader.line_num, 0, "", "", expected)]) from None
    if not rows:
        raise bad_input(str(path), "", f"the file is empty: a header {','.join(columns)} and rows")
    line, header = rows[0]
    header = [name.strip() for name in header]
    missing = [name for name in columns if name not in header]
    if missing:
        meant = closest(missing[0], header)
        raise BadInputError(
            [Problem(str(path), line, 0, "header", ",".join(header), f"the columns {','.join(columns)}",
                     f"{missing[0]} for {meant}" if meant else "")]
        )  # fmt: skip
    if len(rows) == 1:
        raise BadInputError([Problem(str(path), line, 0, "", "", "rows below the header: there are none")])
    found = []
    for number_, row in rows[1:]:
        if len(row) != len(header):
            raise BadInputError(
                [Problem(str(path), number_, 0, "", f"{len(row)} cells", f"{len(header)} cells, as the header has")]
            )
        cells = dict(zip(header, (cell.strip() for cell in row), strict=True))
        found.append((number_, {name: cells[name] for name in columns}))
    return found


def number(path: Path, line: int, column: str, text: str, problems: list[Problem]) -> float:
    """A cell as a number; NaN, and a problem, where it is none."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        problems.append(Problem(str(path), line, 0, column, text or "nothing", "a plain number"))
        return math.nan
    return value
