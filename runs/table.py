"""An archive as tables: one-dimensional columns with the unit in their names, and every other field as a row."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runs.archive import layout
from runs.archive.checked import ArchiveContents, opened
from runs.archive.schema import BYTES, TEXT, ExpectedDataset

Column = NDArray[Any]
ENTRY = "entry"


def tables(path: Path | str) -> tuple[str, ...]:
    """Return the names of the groups of an archive whose rows are those of their `time`."""
    with opened(path) as archive:
        groups = [group for group in archive.groups() if any(map(_by_time, archive.fields(group).values()))]
        return tuple(group.removeprefix(f"{ENTRY}/") for group in groups)


def table(path: Path | str, group: str) -> dict[str, Column]:
    """Return {name: column (n,)} of a group of `tables`, in the order time first; empty where the group is missing.

    A field of several columns becomes one for each actuator, valve, axis or camera: `measured_bar` (N, 3) gives
    `measured_1_bar`, `measured_2_bar` and `measured_3_bar`; `measured_mm` (M, 3) gives `measured_x_mm` and so on, that
    of measured sections `measured_middle_x_mm`. Auxiliary inputs and parameters have their own units: `value_load_N`.
    """
    with opened(path) as archive:
        fields = archive.fields(f"{ENTRY}/{group}")
        names = [name for name in sorted(fields) if _by_time(fields[name])]  # as HDF5 lists them
        if not names:
            return {}
        columns = {"time_s": archive.value(f"{ENTRY}/{group}/time")}
        for name in names:
            columns.update(_columns(archive, f"{ENTRY}/{group}", name))
        return columns


def segments(path: Path | str) -> dict[str, Column]:
    """Return {name: column (S,)} of the protocol's segments as they were played; empty where there are none.

    `start_s` and `stop_s` are in protocol time, as `protocol_time_s` of the tables is; levels are those of the end.
    """
    group = f"{ENTRY}/protocol"
    with opened(path) as archive:
        if not len(archive.value(f"{group}/segment")):
            return {}
        columns: dict[str, Column] = {}
        for name, field in archive.fields(group).items():
            if name == "segment" or _by_segment(field):
                columns.update(_columns(archive, group, name))
        return columns


def facts(path: Path | str) -> dict[str, Column]:
    """Return {name: column} of all fields that neither a table nor the segments have, one number or text a row.

    `field` is the path below /entry, `of` the label of one of several values: of a vector its component, of a file its
    name. Labels and pictures have no rows.
    """
    with opened(path) as archive:
        rows = [row for group in archive.groups() for row in _facts(archive, group)]
    names = ("field", "of", "value", "unit", "uncertainty", "source")
    return {name: np.array([row[k] for row in rows], dtype=object) for k, name in enumerate(names)}


def _facts(archive: ArchiveContents, group: str) -> Iterator[tuple[str, str, str, str, str, str]]:
    fields = archive.fields(group)
    labels = {scale for field in fields.values() for scale in field.scales}
    # A group whose names come from the run has integers of more than one value only as labels.
    labels |= {name for name, field in fields.items() if field.dimensions and field.kind[0] == "i" and not field.scales}
    for name, field in fields.items():
        if name in (*labels, "time") or field.kind == BYTES or _by_time(field) or _by_segment(field):
            continue
        unit, source, uncertainty = archive.about(field.path)
        about = (unit or field.units, "" if math.isnan(uncertainty) else repr(uncertainty), source)
        value = np.asarray(archive.value(field.path), dtype=object)
        named = bool(field.scales) and set(field.scales) <= set(fields)
        numbers = [[str(k + 1) for k in range(length)] for length in value.shape]
        axes = [_labels(archive, group, scale) for scale in field.scales] if named else numbers
        for labelled, one in zip(itertools.product(*axes), value.flat, strict=True):
            yield field.path.removeprefix(f"{ENTRY}/"), " ".join(labelled), str(one), *about


def _by_time(field: ExpectedDataset) -> bool:
    return field.scales[:1] == ("time",) and field.kind != BYTES


def _by_segment(field: ExpectedDataset) -> bool:
    return field.scales[:1] == ("segment",)


def _columns(archive: ArchiveContents, group: str, name: str) -> dict[str, Column]:
    """Return the columns of a field: one for each of its labels, or of their combinations."""
    field = archive.fields(group)[name]
    values = archive.value(f"{group}/{name}")
    if field.kind == TEXT:
        values = np.array(values, dtype=object)
    plain, unit = layout.split_unit(name)
    unit = unit or field.units
    axes = field.scales[1:]
    labels = [_labels(archive, group, axis) for axis in axes]
    units = [_units(archive, group, axis) for axis in axes]
    columns = {}
    for place in np.ndindex(*map(len, labels)):
        own = [known[k] for known, k in zip(units, place, strict=True) if known and known[k]]
        parts = (plain, *(known[k] for known, k in zip(labels, place, strict=True)), unit or ".".join(own))
        columns["_".join(filter(None, parts))] = np.ascontiguousarray(values[(slice(None), *place)])
    return columns


def _labels(archive: ArchiveContents, group: str, axis: str) -> list[str]:
    """Return the names of the columns along an axis."""
    return [f"{label:g}" if isinstance(label, float) else str(label) for label in archive.value(f"{group}/{axis}")]


def _units(archive: ArchiveContents, group: str, axis: str) -> list[str]:
    """Return the unit of each column along an axis; empty where they have none of their own."""
    fields = archive.fields(group)
    for name in ("unit", f"{axis}_unit"):
        if name in fields and fields[name].scales == (axis,):
            return list(archive.value(f"{group}/{name}"))
    return []
