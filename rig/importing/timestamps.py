"""Time of each row of a foreign table: a column of numbers or of dates in ISO 8601, or the number of the row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from protocols.problems import Problem
from rig.importing.mapping import Mapping
from rig.importing.tables import ColumnReader, Key
from rig.importing.units import SECONDS

LONGEST_S = 9e9
"""Times beyond this have no nanoseconds in 64 bits."""

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class RowTimes:
    """Times of the rows `t_ns` (n,) on the file's own clock, increasing; `utc` where that clock counts from 1970."""

    t_ns: Ints
    utc: bool


def times(columns: ColumnReader, mapping: Mapping) -> RowTimes:
    """The rows' times; what the file lacks of them becomes a problem of the columns."""
    column, unit = mapping.time.column, mapping.time.unit
    if mapping.time.period_ms is not None:
        return _counted(columns, mapping.pressures.columns[0], mapping.time.period_ms)
    assert column is not None
    assert unit is not None
    found = _dates(columns, column) if unit == "iso" else _numbers(columns, column, SECONDS[unit])
    if found is None:
        return RowTimes(np.array([0, 1], np.int64), utc=False)
    read, row_text = found
    problems = []
    early = (np.flatnonzero(np.diff(read.t_ns) <= 0) + 1).tolist()

    def not_later(row: int) -> Problem:
        return columns.table.problem(
            row, column, row_text(row), f"a time after {row_text(row - 1)}, that of the row before"
        )

    problems += columns.table.first_problems(column, early, not_later)
    columns.problems += [*problems, *_too_few(columns, read)]
    return read


def _too_few(columns: ColumnReader, read: RowTimes) -> list[Problem]:
    count = len(read.t_ns)
    return [Problem(columns.table.file, 0, 0, "", f"{count} rows", "two rows at least")] if count < 2 else []


def _counted(columns: ColumnReader, column: Key, period_ms: float) -> RowTimes:
    """Times by the numbers of the rows, of which `column` says how many there are."""
    values = columns.scaled(column, 1.0)
    if values is None:
        return RowTimes(np.array([0, 1], np.int64), utc=False)
    read = RowTimes(np.round(np.arange(len(values)) * period_ms * 1e6).astype(np.int64), utc=False)
    columns.problems += _too_few(columns, read)
    return read


RowText = Callable[[int], str]
"""A row's time in words."""


def _numbers(columns: ColumnReader, column: Key, scale: float) -> tuple[RowTimes, RowText] | None:
    time_s = columns.scaled(column, scale)
    if time_s is None:
        return None
    wrong = np.flatnonzero(~(np.abs(time_s) <= LONGEST_S)).tolist()

    def no_time(row: int) -> Problem:
        value = "nothing" if np.isnan(time_s[row]) else f"{time_s[row]:g} s"
        return columns.table.problem(row, column, value, f"a time of at most {LONGEST_S:g} s")

    columns.problems += columns.table.first_problems(column, wrong, no_time)
    if wrong:
        return None
    return RowTimes(np.round(time_s * 1e9).astype(np.int64), utc=False), lambda row: f"{time_s[row]:.12g} s"


def _dates(columns: ColumnReader, column: Key) -> tuple[RowTimes, RowText] | None:
    cells = columns.texts(column)
    if cells is None:
        return None
    moments = [_moment(cell) for cell in cells]
    first = next((moment for moment in moments if moment is not None), None)
    zoned = first is not None and first.tzinfo is not None
    expected = f"date and time in ISO 8601, as 2026-11-21T14:05:00.250{'+01:00' if zoned else ''}"
    wrong = [row for row, moment in enumerate(moments) if moment is None or (moment.tzinfo is not None) != zoned]
    table = columns.table
    columns.problems += table.first_problems(
        column, wrong, lambda row: table.problem(row, column, cells[row] or "nothing", expected)
    )
    if wrong:
        return None
    epoch = datetime(1970, 1, 1, tzinfo=UTC if zoned else None)
    passed_us = [(moment - epoch) // timedelta(microseconds=1) for moment in moments if moment is not None]
    return RowTimes(1000 * np.array(passed_us, np.int64), utc=zoned), lambda row: cells[row]


def _moment(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None
