"""What a column is: its declaration, and the table that holds columns of one group."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, overload

import numpy as np
from numpy.typing import NDArray

Values = NDArray[Any]

OLDEST_LAYOUT = 2
"""The oldest layout of archives that is read. Increased when a field moves or changes its meaning."""


LARGEST = 1e12
"""Numbers of an archive are at most as large as this in their units; none is infinite."""


def _same(values: Values) -> Values:
    return values


@dataclass(eq=False)
class Column:
    """One column: a field of a record, a dataset of the archive, an attribute of the group as it is read.

    `record` names the field, in SI units, of type `dtype` and of shape `shape` (by default `axes`). A column that the
    archive computes from other fields has none, but `of`: rows (n,) to values (n, ..). `axes` are the scales of the
    dataset's dimensions after the rows. `convert` gives the stored values of the field, `read` the attribute of the
    stored values, `inverse` the field of the attribute: a replay copies the columns that it does not compute again.
    `missing` is the value of a field that is not set; an integer is 0.

    `dataset` is by default the name of the attribute. `among` has the values of an enumeration.
    `since` is the layout that the column came with: in an archive of an earlier one its values are `missing`.
    """

    record: str = ""
    dtype: str = "<f8"
    axes: tuple[str, ...] = ()
    shape: tuple[str, ...] = ()
    unit: str = ""
    about: str = ""
    convert: Callable[[Values], Values] = _same
    of: Callable[[NDArray[np.void]], Values] | None = None
    read: Callable[[Values], Values] = _same
    inverse: Callable[[Values], Values] | None = None
    missing: float = float("nan")
    dataset: str = ""
    among: tuple[int, ...] = ()
    since: int = OLDEST_LAYOUT
    name: str = field(default="", init=False)
    """The attribute."""

    def __set_name__(self, owner: type[Table], name: str) -> None:
        self.name = name
        self.dataset = self.dataset or name

    @overload
    def __get__(self, table: None, owner: type[Table]) -> Column: ...
    @overload
    def __get__(self, table: Table, owner: type[Table]) -> Values: ...
    def __get__(self, table: Table | None, owner: type[Table]) -> Column | Values:
        return self if table is None else table.values[self.name]

    @property
    def unset(self) -> float:
        """The value of a row without one, as the archive stores it."""
        return self.missing if np.dtype(self.dtype).kind == "f" else 0

    def stored(self, rows: NDArray[np.void]) -> Values:
        """Return the values that the archive stores of records (n,); one beyond `LARGEST` is none (NaN).

        A broken driver may give any number, and the archive of its run has to be readable.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            values = self.convert(rows[self.record]) if self.of is None else self.of(rows)
        if values.dtype.kind != "f":
            return values
        beyond = np.abs(values) > LARGEST
        return np.where(beyond, np.nan, values) if beyond.any() else values

    def recorded(self, values: Values) -> Values:
        """Return the field of records of the attribute's values.

        Raises:
            TypeError: the column converts its field, and has no `inverse`.
        """
        if self.inverse is None:
            if self.convert is not _same or self.read is not _same:
                raise TypeError(f"column {self.name}: expected `inverse`, which gives {self.record} of its values")
            return values
        found = self.inverse(values)
        return found if np.dtype(self.dtype).kind == "f" else np.round(found).astype(self.dtype)


class Table:
    """The columns of one group of the archive, as it is read: each is an attribute, an array (n, ..)."""

    group: ClassVar[str]
    rows: ClassVar[str]
    """Size of the rows in the reference page."""
    signal: ClassVar[str]
    """Dataset that a viewer plots."""
    about: ClassVar[str] = ""
    facts: ClassVar[tuple[tuple[str, str], ...]] = ()
    """Datasets beside the columns: the attribute of each as it is read, and its name."""

    def __init__(self, values: Mapping[str, Values], facts: Mapping[str, Any] | None = None) -> None:
        self.values = dict(values)
        for name, fact in (facts or {}).items():
            single = fact.item() if isinstance(fact, np.generic) else fact
            setattr(self, name, tuple(single) if isinstance(single, list) else single)

    @classmethod
    def columns(cls) -> tuple[Column, ...]:
        """Return the columns in the order of their declaration."""
        return tuple(one for one in vars(cls).values() if isinstance(one, Column))

    def set_fields(self, rows: NDArray[np.void], which: int | slice = slice(None)) -> None:
        """Set the fields of records from rows of the table, except their time.

        Raises:
            TypeError: a column has no `inverse`.
        """
        for column in self.columns():
            if column.record not in ("", "t_ns"):
                rows[column.record] = column.recorded(self.values[column.name][which])

    def replaced(self, **values: Values) -> Self:
        """Return the table with other values in some columns."""
        copy = self.__class__.__new__(self.__class__)
        copy.__dict__ = {**self.__dict__, "values": {**self.values, **values}}
        return copy
