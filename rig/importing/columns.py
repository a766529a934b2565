"""Read columns of a foreign table and collect their problems and warnings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from model.arrays import Array
from protocols.problems import BadInputError, Problem, raise_all
from rig.importing.tables import Key, SourceTable


class ColumnReader:
    """Reads columns of a table; collects errors in `problems` and doubts in `warnings`."""

    def __init__(self, table: SourceTable) -> None:
        self.table = table
        self.problems: list[Problem] = []
        self.warnings: list[str] = []
        self._length: tuple[Key, int] | None = None

    def scaled(self, column: Key, scale: float) -> Array | None:
        """Return a column (n,) times `scale`; None, and a problem, where it cannot be read."""
        try:
            values = self.table.numbers(column)
        except BadInputError as bad:
            self.problems += bad.problems
            return None
        if self._length is None:
            self._length = (column, len(values))
        first, length = self._length
        if len(values) != length:
            expected = f"{length} rows, as in column {first}"
            found = f"{len(values)} rows in column {column}"
            self.refuse(found, expected)
            return None
        return values * scale

    def texts(self, column: Key) -> Sequence[str] | None:
        """The cells (n,) of a column as they are written; None, and a problem, where it has no such ones."""
        try:
            cells = self.table.texts(column)
        except BadInputError as bad:
            self.problems += bad.problems
            return None
        self._length = self._length or (column, len(cells))
        return cells

    def read_columns(self, columns: Sequence[Key], scales: Sequence[float]) -> Array:
        """Columns (n, k), each times its scale; NaN stands for one that cannot be read, beside its problem."""
        length = self._length[1] if self._length else 2
        found = [self.scaled(column, scale) for column, scale in zip(columns, scales, strict=True)]
        length = self._length[1] if self._length else length
        return np.column_stack([np.full(length, np.nan) if values is None else values for values in found])

    def refuse(self, found: str, expected: str, where: str = "") -> None:
        """Add a problem of the whole table, or of a part of it."""
        self.problems.append(Problem(self.table.file, 0, 0, where, found, expected))

    def warn(self, message: str) -> None:
        """Add a warning, once."""
        if message not in self.warnings:
            self.warnings.append(message)

    def warn_missing(self, values: Array, what: str) -> None:
        """Warn if some of the values (n,) or (n, k) are missing."""
        rows = np.flatnonzero(~np.isfinite(values if values.ndim == 1 else values.sum(axis=1)))
        if len(rows):
            where = self.table.place(int(rows[0]))
            self.warn(f"{what} is missing in {len(rows)} of {len(values)} rows, the first in {where}")

    def check(self) -> None:
        raise_all(self.problems)
