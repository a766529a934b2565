"""Building blocks of an archive: groups of fields with units and dimension scales."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from runs.columns.declaration import OLDEST_LAYOUT

CHUNK_ROWS = 16384
"""Rows of a chunk of a dataset, and rows that are held at once."""
QUANTITY_GROUPS = {
    "protocol": "entry/protocol/parameters",
    "calibration": "entry/calibration",
    "model": "entry/model",
}
"""The group of the quantities of each room."""

Value = NDArray[np.generic] | np.generic | str | int | float | list[str]


class RowTable(Protocol):
    """A table that is read in chunks of rows."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice) -> Any: ...


def row_chunks(table: RowTable) -> Iterator[Any]:
    """Yield the rows of a table in chunks of `CHUNK_ROWS`."""
    return (table[low : low + CHUNK_ROWS] for low in range(0, len(table), CHUNK_ROWS))


@dataclass(frozen=True)
class ComputedColumn:
    """A column computed from a table; `of` maps a chunk of rows to as many values."""

    table: RowTable
    of: Callable[[Any], NDArray[np.generic] | list[str] | list[memoryview]]


@dataclass(frozen=True)
class Field:
    """One dataset. `scales` names the dataset of the same group that labels each dimension.

    `since` is the layout that it came with. `any_length`: a scale whose length is the run's own, as that of the
    cameras' names. `among`: the values of an enumeration. `pictures`: the values are encoded pictures, each of its own
    length.
    """

    name: str
    value: Value | ComputedColumn
    units: str = ""
    about: str = ""
    scales: tuple[str, ...] = ()
    source: str = ""
    uncertainty: float | None = None
    any_length: bool = False
    among: tuple[str | int, ...] = ()
    since: int = OLDEST_LAYOUT
    pictures: bool = False

    @property
    def sample(self) -> Any:
        """The value; of a column as many rows as show its kind: none."""
        return self.value.of(self.value.table[:0]) if isinstance(self.value, ComputedColumn) else self.value


@dataclass(frozen=True)
class Group:
    """One group below the root. `open`: the names of its fields depend on the run, as those of the counters."""

    path: str
    nx_class: str
    fields: tuple[Field, ...]
    signal: str = ""
    axes: tuple[str, ...] = ()
    about: str = ""
    default: str = ""
    open: bool = False


def named(fields: Iterable[Field]) -> tuple[Field, ...]:
    """Make names valid for HDF5: without `/`, not empty, unique."""
    taken: set[str] = set()
    named = []
    for field in fields:
        plain = field.name.replace("/", ".").replace("\0", "").strip(".") or "unnamed"
        name, number = plain, 1
        while name in taken:
            number += 1
            name = f"{plain}.{number}"
        taken.add(name)
        named.append(replace(field, name=name))
    return tuple(named)
