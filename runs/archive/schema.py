"""What an archive must hold, derived from the layout that archives are written by.

These are the groups of the layout for two synthetic journals: one that has everything, and one that has only what every
run has. What both have is required; what only the first has may be missing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import h5py
import numpy as np

from runs.archive import layout
from runs.archive.fields import QUANTITY_GROUPS, ComputedColumn, Field, Group
from runs.columns.declaration import OLDEST_LAYOUT
from runs.journal.journal import Journal
from runs.journal.row_kinds import ROW_KINDS
from runs.journal.stored_rows import Index, StoredPictures, StoredRows
from runs.records import (
    AuxiliaryChannel,
    PlayedSegment,
    Quantity,
    RecordedFile,
    RunFooter,
    RunHeader,
    SectionPlace,
    Status,
    StudyRole,
    StudyRun,
)

TEXT, BYTES = "text", "bytes"
_NAMES = {"f4": "32-bit floats", "f8": "64-bit floats", TEXT: "text", BYTES: "bytes, each row of its own length"}

Dimension = int | str
"""A fixed length, or the path of the dataset whose length it is."""


@dataclass(frozen=True)
class ExpectedDataset:
    """One dataset: `kind` is that of its numbers as `kind_of` returns it, `TEXT` or `BYTES`."""

    path: str
    kind: str
    dimensions: tuple[Dimension, ...]
    required: bool
    units: str = ""
    scales: tuple[str, ...] = ()
    among: tuple[str | int, ...] = ()
    since: int = OLDEST_LAYOUT

    @property
    def name(self) -> str:
        """Name in its group."""
        return self.path.rpartition("/")[2]


@dataclass(frozen=True)
class GroupSchema:
    """One group: its datasets by name and, where the run names them, what each other one may be like."""

    path: str
    required: bool
    datasets: Mapping[str, ExpectedDataset]
    alike: tuple[ExpectedDataset, ...] = field(default=())


def kind_of(dtype: Any) -> str:
    """Return the kind of a dataset by its dtype: that of numbers, `TEXT` or `BYTES`; empty for any other."""
    if (text := h5py.check_string_dtype(dtype)) is not None:
        return TEXT if text.length is None else ""
    if (base := h5py.check_vlen_dtype(dtype)) is not None:
        return BYTES if base == np.uint8 else ""
    return str(dtype.str[1:]) if dtype.kind in "iuf" and dtype.subdtype is None else ""


def name_of(kind: str) -> str:
    """Return a kind in words."""
    return _NAMES.get(kind, f"{8 * int(kind[1:])}-bit integers" if kind[:1] in ("i", "u") else kind)


@cache
def schema(actuators: int, valves: int) -> tuple[GroupSchema, ...]:
    """Return every group that the archive of a rig with so many actuators and valves can have, outer ones first."""
    everything = layout.groups(_journal(actuators, valves, everything=True))
    least = {group.path: group for group in layout.groups(_journal(actuators, valves, everything=False))}
    first_of: dict[int, str] = {}
    return tuple(sorted((_group(group, least.get(group.path), first_of) for group in everything), key=_depth))


def _depth(group: GroupSchema) -> int:
    return group.path.count("/")


def _group(group: Group, least: Group | None, first_of: dict[int, str]) -> GroupSchema:
    always = {item.name for item in least.fields} if least is not None else set()
    known = {
        one.name: one
        for one in _datasets(group, always if least is not None else {i.name for i in group.fields}, first_of)
    }
    if not group.open:
        return GroupSchema(group.path, least is not None, known)
    alike = tuple(one for one in known.values() if one.name not in always)
    return GroupSchema(group.path, least is not None, {n: one for n, one in known.items() if n in always}, alike)


def _datasets(group: Group, required: set[str], first_of: dict[int, str]) -> Iterator[ExpectedDataset]:
    """Go through the datasets of a group; `first_of` has, for each table, the path of a dataset with its rows."""
    own: dict[str, Dimension] = {}
    for item in group.fields:
        path = f"{group.path}/{item.name}"
        if isinstance(item.value, ComputedColumn):
            own[item.name] = first_of.setdefault(id(item.value.table), path)
        elif np.ndim(item.value):
            own[item.name] = path if group.open or item.any_length else len(np.asarray(item.value))
    for item in group.fields:
        path = f"{group.path}/{item.name}"
        names = item.scales or ((item.name,) if item.name in own else ())
        dimensions = tuple(own[name] if not group.open else own[item.name] for name in names)
        kind = _kind(item)
        yield ExpectedDataset(
            path=path,
            kind=kind,
            dimensions=dimensions,
            required=item.name in required,
            units=item.units,
            scales=item.scales,
            among=item.among,
            since=item.since,
        )


def _kind(item: Field) -> str:
    if item.pictures:
        return BYTES
    return TEXT if isinstance(item.sample, str | list) else kind_of(np.asarray(item.sample).dtype)


def _journal(actuators: int, valves: int, *, everything: bool) -> Journal:
    """Return a journal that gives an archive all of its groups and fields, or only those that every archive has."""
    adapted = (Quantity("adaptation", "parameter", (0.0,), "", "", 0.0),)
    files = (RecordedFile.of("file", "kind", ""),)
    quantities = tuple(
        Quantity(room, name, value, "", "") for room in QUANTITY_GROUPS for name, value in _QUANTITIES.items()
    )
    header = RunHeader(
        run_id="",
        title="",
        started_utc_ns=0,
        started_t_ns=0,
        protocol_name="",
        actuators=actuators,
        valves=valves,
        executor="",
        simulated=everything,
        seed=0 if everything else None,
        metadata={"specimen": "", "email": "-"} if everything else {},
        versions={"library": ""} if everything else {},
        intervals=(PlayedSegment(0.0, 0.0, "", "", ()),),
        quantities=quantities if everything else (),
        protocol_files=files if everything else (),
        calibrations=files if everything else (),
        adapted=adapted if everything else (),
        cameras=("camera",) if everything else (),
        tracker="tracker" if everything else "",
        tip_controller="controller" if everything else "",
        learned_from=("run",) if everything else (),
        streams=everything,
        triggered=everything,
        sections=(SectionPlace("section", 0.0),) if everything else (),
        auxiliary=(AuxiliaryChannel("input", ""),) if everything else (),
        valve_units=("",) * valves if everything else (),
        study=StudyRun("", StudyRole.RUN, 1, 1, 1, "", "") if everything else None,
    )
    rows = 1 if everything else 0
    return Journal(
        header=header,
        footer=RunFooter(0, Status.FINISHED, "", {"counter": 0} if everything else {}),
        events=(),
        pictures=StoredPictures(memoryview(b"")),
        damage=(),
        **{kind.name: _rows(kind.dtype(header), rows if kind.name == "observations" else 0) for kind in ROW_KINDS},
    )


_QUANTITIES = {"number": (0.0,), "vector": (0.0, 0.0)}


def _rows(kind: np.dtype[np.void], count: int) -> StoredRows:
    index = Index()
    if count:
        index.add(0, count)
    # No field is zero, which some groups take for absent.
    return StoredRows(memoryview(b"\x01" * (count * kind.itemsize)), kind, kind, index)
