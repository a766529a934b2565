"""Reads an archive: every group as a frozen dataclass of NumPy arrays, loaded on first access."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from runs.archive.checked import opened
from runs.archive.column_groups import TABLE_GROUPS, clock_ns
from runs.archive.fields import QUANTITY_GROUPS
from runs.archive.provenance import metadata, study_run
from runs.arrays import Array
from runs.columns import (
    Adaptation,
    Auxiliary,
    Backbone,
    Learning,
    Pressure,
    Reference,
    Sections,
    Simulated,
    StreamedSetPoints,
    Timing,
    Tip,
    TipControl,
    TrackerClock,
    TriggeredFrame,
    TriggerPulse,
    ValveOutput,
)
from runs.columns.conversions import PA_PER_BAR
from runs.columns.declaration import Column, Table, Values
from runs.journal.row_kinds import RowKind
from runs.records import (
    AuxiliaryChannel,
    Event,
    Level,
    PlayedSegment,
    Quantity,
    RecordedFile,
    RunHeader,
    SectionPlace,
    Status,
    blank,
)

Ints = NDArray[np.int64]
T = TypeVar("T", bound=Table)


@dataclass(frozen=True)
class Frames:
    """The stored pictures (k,); `ArchiveReader.picture` returns their bytes."""

    time_s: Array
    index: Ints
    camera: tuple[str, ...]
    encoding: tuple[str, ...]
    corners_px: NDArray[np.float32]
    """(k, corners, 2); NaN where no board was found."""
    tip_px: NDArray[np.float32]
    """(k, 2), measured."""
    model_px: NDArray[np.float32]
    """(k, 2)."""
    backbone_px: NDArray[np.float32]
    """(k, points, 2), the model's."""


def _required(kind: type[T]) -> cached_property[T]:
    """Return the attribute of a table that every run has, read on first access."""

    def read(archive: ArchiveReader) -> T:
        found = archive._table(kind)
        assert found is not None
        return found

    return cached_property(read)


def _optional(kind: type[T]) -> cached_property[T | None]:
    """Return the attribute of a table that is None for a run without it, read on first access."""
    return cached_property(lambda archive: archive._table(kind))


class ArchiveReader:
    """The recorded data of one run. The file is open only during a read; each group is read whole on first access."""

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        with opened(self.path) as archive:
            self.sha256 = archive.sha256
            """Digest of the file."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.path)!r})"

    @cached_property
    def header(self) -> RunHeader:
        """Everything known before the first sample."""
        entry = self._entry
        protocol, rig, git = (self._group(f"entry/{name}") for name in ("protocol", "rig", "git"))
        return RunHeader(
            run_id=entry["run_id"],
            title=entry["title"],
            started_utc_ns=int(entry["start_utc"]),
            started_t_ns=int(entry["start_clock"]),
            protocol_name=protocol["name"],
            protocol_yaml=protocol["yaml"],
            rig_name=rig["name"],
            rig_yaml=rig["yaml"],
            parameters_yaml=rig["parameters"],
            protocol_files=_sources(self._group("entry/protocol_files"), "text"),
            calibrations=_sources(self._group("entry/calibration_files"), "yaml"),
            actuators=int(entry["actuators"]),
            valves=int(entry["valves"]),
            executor=entry["executor"],
            parent=entry["parent"],
            simulated=bool(entry["simulated"]),
            seed=int(entry["seed"]) if "seed" in entry else None,
            model_variant=self._group("entry/model")["variant"],
            operator=entry["operator"],
            notes=entry["notes"],
            command=entry["command"],
            host=entry["host"],
            metadata=metadata(self._group("entry/sample"), self._group("entry/user")),
            versions=self._group("entry/versions"),
            git_commit=git["commit"],
            git_diff=git["diff"],
            intervals=_intervals(protocol),
            quantities=tuple(q for room in QUANTITY_GROUPS for q in self._quantities(room)),
            adapted=_adapted(self._group("entry/adaptation")),
            tip_controller=str(self._group("entry/tip_control").get("controller", "")),
            learned_from=tuple(self._group("entry/learning").get("run", ())),
            streams=bool(self._group("entry/stream", without="setpoint_bar")),
            triggered=bool(self._group("entry/trigger", without="pulse")),
            sections=_section_places(self._group("entry/sections", without="measured_mm")),
            control_hz=float(self._group("entry/timing")["control_rate"]),
            camera_hz=float(self._group("entry/timing")["camera_rate"]),
            cameras=self._cameras,
            tracker=str(self._group("entry/tracker").get("name", "")),
            study=study_run(self._group("entry/study")),
            auxiliary=_auxiliary(self._group("entry/aux", without="value")),
            valve_units=tuple(self._group("entry/valve_output", without="output").get("valve_unit", ())),
        )

    @cached_property
    def status(self) -> Status:
        """How the run ended."""
        return Status(self._entry["status"])

    @cached_property
    def message(self) -> str:
        """Reason for the end of the run."""
        return str(self._entry["message"])

    @cached_property
    def duration_s(self) -> float:
        """From start to end, waiting included."""
        return float(self._entry["duration"])

    @cached_property
    def arm(self) -> dict[str, Quantity]:
        """The parameters of the modelled arm by name, each with unit, source and uncertainty."""
        return {quantity.name: quantity for quantity in self._quantities("model")}

    pressure = _required(Pressure)
    tip = _required(Tip)
    backbone = _optional(Backbone)
    simulated = _optional(Simulated)
    sections = _optional(Sections)
    auxiliary = _optional(Auxiliary)
    valve_outputs = _optional(ValveOutput)
    adaptation = _optional(Adaptation)
    reference = _optional(Reference)
    learning = _optional(Learning)
    tip_control = _optional(TipControl)
    streamed = _optional(StreamedSetPoints)
    tracker = _optional(TrackerClock)
    trigger = _optional(TriggerPulse)
    exposure = _optional(TriggeredFrame)

    @cached_property
    def timing(self) -> Timing:
        """Lateness and losses."""
        timing = self._table(Timing)
        assert timing is not None
        timing.counters = {name: int(count) for name, count in self._group("entry/timing/counters").items()}
        return timing

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """Events in the order of recording."""
        g = self._group("entry/events")
        start_ns = self.header.started_t_ns
        return tuple(
            Event(start_ns + round(t * 1e9), Level(level), source, message)
            for t, level, source, message in zip(g["time"], g["level"], g["source"], g["message"], strict=True)
        )

    @cached_property
    def frames(self) -> Frames:
        """The stored pictures, without their bytes."""
        g = self._group("entry/frames", without="image")
        return Frames(
            time_s=g["time"],
            index=g["index"],
            camera=tuple(g["camera"]),
            encoding=tuple(g["encoding"]),
            corners_px=g["corners_px"],
            tip_px=g["tip_px"],
            model_px=g["model_px"],
            backbone_px=g["backbone_px"],
        )

    def picture(self, k: int) -> bytes:
        """Return the encoded bytes of the k-th stored picture."""
        with opened(self.path) as archive:
            data: bytes = archive.row("entry/frames/image", k).tobytes()
            return data

    def rows(self, kind: RowKind) -> NDArray[np.void]:
        """Return the records (n,) of a kind, in SI units; a field that the archive does not hold is not set.

        Raises:
            TypeError: one of their columns has no `inverse`.
        """
        kinds = [group.kind for group in TABLE_GROUPS if group.rows == kind.name]
        tables = [table for table in map(self._table, kinds) if table is not None]
        time_s = tables[0].values["time_s"] if tables else np.empty(0)
        rows = blank(len(time_s), kind.dtype(self.header))
        rows["t_ns"] = clock_ns(time_s, self.header.started_t_ns)
        for table in tables:
            table.set_fields(rows)
        return rows

    def _table(self, kind: type[T]) -> T | None:
        """Return a table; None if the archive has no such group."""
        g = self._group(f"entry/{kind.group}")
        if not g:
            return None
        values = {c.name: c.read(g[c.dataset] if c.dataset in g else _unset(c, g)) for c in kind.columns()}
        return kind(values, {name: g[dataset] for name, dataset in kind.facts if dataset in g})

    @cached_property
    def _entry(self) -> dict[str, Any]:
        return self._group("entry")

    def _group(self, path: str, without: str = "") -> dict[str, Any]:
        """Return the datasets of a group by name: arrays, texts and numbers; empty if the group is missing."""
        with opened(self.path) as archive:
            return archive.values(path, without)

    @cached_property
    def _cameras(self) -> tuple[str, ...]:
        with opened(self.path) as archive:
            return tuple(archive.value("entry/tip/camera")) if "camera" in archive.fields("entry/tip") else ()

    def _quantities(self, room: str) -> Iterator[Quantity]:
        with opened(self.path) as archive:
            for name, field in archive.fields(QUANTITY_GROUPS[room]).items():
                # Only quantities are floats: scales are integers, the variant is text.
                if field.kind == "f8":
                    value = tuple(float(v) for v in np.atleast_1d(archive.value(field.path)))
                    unit, source, uncertainty = archive.about(field.path)
                    yield Quantity(room, name, value, unit, source, uncertainty)


def _unset(column: Column, group: dict[str, Any]) -> Values:
    """Return a column that an archive lacks: one per camera without cameras, or one of a newer layout."""
    shape = (len(group["time"]), *(len(group.get(axis, ())) for axis in column.axes))
    return np.full(shape, column.unset, column.dtype)


def _auxiliary(g: dict[str, Any]) -> tuple[AuxiliaryChannel, ...]:
    columns = (g.get(key, ()) for key in ("input", "input_unit"))
    return tuple(AuxiliaryChannel(name, unit) for name, unit in zip(*columns, strict=True))


def _section_places(g: dict[str, Any]) -> tuple[SectionPlace, ...]:
    columns = (g.get(key, ()) for key in ("section", "at_mm"))
    return tuple(SectionPlace(name, float(at_mm)) for name, at_mm in zip(*columns, strict=True))


def _adapted(g: dict[str, Any]) -> tuple[Quantity, ...]:
    columns = ("parameter", "start", "unit", "start_uncertainty")
    return tuple(
        Quantity("adaptation", name, (float(start),), unit, "the run's start", float(doubt))
        for name, start, unit, doubt in (zip(*(g[column] for column in columns), strict=True) if g else ())
    )


def _sources(g: dict[str, Any], text: str) -> tuple[RecordedFile, ...]:
    columns = ([str(text) for text in g.get(key, ())] for key in ("name", "kind", "sha256", text))
    return tuple(RecordedFile(*row) for row in zip(*columns, strict=True))


def _intervals(g: dict[str, Any]) -> tuple[PlayedSegment, ...]:
    return tuple(
        PlayedSegment(float(start), float(stop), kind, label, tuple(float(v) * PA_PER_BAR for v in level))
        for start, stop, kind, label, level in zip(
            g["start"], g["stop"], g["kind"], g["label"], g["level_bar"], strict=True
        )
    )
