"""What an archive is made of: fields in groups, with their units and what labels their dimensions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

PA_PER_BAR = 1e5

Value = NDArray[np.generic] | np.generic | str | int | float | list[str]


@dataclass(frozen=True)
class Field:
    """One dataset. `scales` names the dataset of the same group that labels each dimension."""

    name: str
    value: Value
    units: str = ""
    about: str = ""
    scales: tuple[str, ...] = ()
    source: str = ""
    uncertainty: float | None = None


@dataclass(frozen=True)
class Pictures:
    """The encoded pictures (K,), each of its own length."""

    name: str
    data: Sequence[memoryview]
    scales: tuple[str, ...]
    about: str


@dataclass(frozen=True)
class Group:
    """One group below the file's root."""

    path: str
    nx_class: str
    fields: tuple[Field | Pictures, ...]
    signal: str = ""
    axes: tuple[str, ...] = ()
    about: str = ""
    default: str = ""


def named(fields: Iterable[Field]) -> tuple[Field, ...]:
    """Make names that came from elsewhere fit for HDF5: without `/`, none empty, no two the same."""
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
