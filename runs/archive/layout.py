"""Layout of an archive: a journal as NeXus groups and fields, in bar, mm and us.

The documentation for users is `docs/reference/archive.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runs import columns
from runs.archive import column_groups, provenance
from runs.archive.fields import ComputedColumn, Field, Group, named
from runs.journal.journal import Journal
from runs.journal.stored_rows import StoredPictures
from runs.records import Event, Level, Picture, Status

VERSION = max(column.since for table in columns.TABLES for column in table.columns())
"""Layout of the archives that are written: that of the newest column."""

MOST_CHANNELS = 4096
"""Most actuators, or valves, of an archive."""
UNITS = ("mm_deg", "bar", "V", "mm", "mm2", "px", "s", "ms", "us", "g", "N", "Nm", "deg", "deg2", "ppm")
"""Unit suffixes of column names; one that ends with another comes first."""


def split_unit(name: str) -> tuple[str, str]:
    """Return a field's name without its unit, and the unit; `measured_mm` is `measured` in `mm`."""
    unit = next((unit for unit in UNITS if name.endswith(f"_{unit}")), "")
    return name.removesuffix(f"_{unit}") if unit else name, unit


def groups(journal: Journal) -> tuple[Group, ...]:
    """Return every group of the archive of a journal."""
    found = (
        _entry(journal),
        provenance.protocol(journal),
        provenance.protocol_parameters(journal),
        provenance.rig(journal),
        provenance.protocol_files(journal),
        provenance.calibration_files(journal),
        provenance.sample(journal),
        provenance.user(journal),
        provenance.study(journal),
        provenance.versions(journal),
        provenance.git(journal),
        *(table.of(journal) for table in column_groups.TABLE_GROUPS),
        _counters(journal),
        _frames(journal),
        _events(journal),
        provenance.quantities(journal, "calibration", "what was calibrated, as it was used"),
        provenance.quantities(journal, "model", "every number of the model, as it was used"),
    )
    return tuple(group for group in found if group is not None)


def utc(nanoseconds: int) -> str:
    """Return UTC nanoseconds since 1970 in ISO 8601, to the microsecond."""
    whole, rest = divmod(nanoseconds, 1_000_000_000)
    return datetime.fromtimestamp(whole, UTC).strftime("%Y-%m-%dT%H:%M:%S.") + f"{rest // 1000:06d}Z"


def end_t_ns(journal: Journal) -> int:
    """Return when the run ended: by its footer, or by the last record."""
    if journal.footer is not None:
        return journal.footer.t_ns
    last = [journal.header.started_t_ns]
    for rows in (journal.samples, journal.observations):
        last += [int(row["t_ns"]) for row in rows[max(0, len(rows) - 1) :]]
    last += [event.t_ns for event in journal.events[-1:]]
    return max(last)


def status(journal: Journal) -> tuple[Status, str]:
    """Return the status of the run and its message."""
    if journal.footer is not None:
        return journal.footer.status, journal.footer.message
    return Status.RECOVERED, "the run was cut off; the archive was made from what its journal holds"


def _entry(journal: Journal) -> Group:
    header = journal.header
    end_ns = end_t_ns(journal)
    ended, message = status(journal)
    fields = [
        Field("title", header.title, about="of the protocol"),
        Field("start_time", utc(header.started_utc_ns), about="ISO 8601, UTC, to the microsecond"),
        Field("end_time", utc(header.started_utc_ns + end_ns - header.started_t_ns), about="ISO 8601, UTC"),
        Field(
            "duration",
            (end_ns - header.started_t_ns) / 1e9,
            "s",
            "from start to end, with waits",
        ),
        Field("run_id", header.run_id, about="name of the run and of its files"),
        Field("status", str(ended), about="finished, interrupted, aborted or recovered", among=tuple(Status)),
        Field("message", message, about="why the run ended as it did"),
        Field(
            "simulated",
            np.int8(header.simulated),
            about="1 where the card, the camera or the arm was simulated",
        ),
        Field("executor", header.executor, about="real time, virtual time, model alone or imported"),
        Field("parent", header.parent, about="run that this replay was made from; empty for a run"),
        Field("operator", header.operator, about="who ran the experiment"),
        Field("notes", header.notes, about="what the operator noted at the start"),
        Field("command", header.command, about="the command line"),
        Field("host", header.host, about="name of the computer"),
        Field("start_utc", np.int64(header.started_utc_ns), "ns", "start_time since 1970, exactly"),
        Field("start_clock", np.int64(header.started_t_ns), "ns", "start_time on the own clock"),
        Field("actuators", np.int32(header.actuators), about="number of actuators"),
        Field("valves", np.int32(header.valves), about="number of valves"),
    ]
    if header.seed is not None:
        fields.append(Field("seed", np.int64(header.seed), about="of everything random in the simulator"))
    return Group("entry", "NXentry", tuple(fields), default="tip")


def _counters(journal: Journal) -> Group:
    counters = journal.footer.counters if journal.footer else {}
    fields = (
        Field(name, np.int64(count), about=f"{name.replace('_', ' ')} over the run")
        for name, count in sorted(counters.items())
    )
    return Group(
        "entry/timing/counters", "NXcollection", named(fields), about="as the executor counted them", open=True
    )


def _frames(journal: Journal) -> Group:
    return Group(
        "entry/frames",
        "NXcollection",
        (*_picture_fields(journal), *_mark_fields(journal.pictures)),
        about="the kept pictures and what was seen in them; NaN where there was nothing",
    )


def _picture_fields(journal: Journal) -> tuple[Field, ...]:
    """Time, camera and bytes of each kept picture."""
    pictures, by = journal.pictures, ("time",)

    def column(values: Callable[[Sequence[Picture]], Any]) -> ComputedColumn:
        return ComputedColumn(pictures, values)

    seconds = column(lambda some: column_groups.seconds(journal, np.array([p.t_ns for p in some], np.int64)))
    index = column(lambda some: np.array([p.frame for p in some], np.int64))
    image = column(lambda some: [p.data for p in some])
    return (
        Field("time", seconds, "s", "middle of the exposure, since start_time"),
        Field("index", index, about="as tip/frame", scales=by),
        Field("camera", column(lambda some: [p.camera for p in some]), about="name of the camera", scales=by),
        Field("encoding", column(lambda some: [p.encoding for p in some]), about="jpeg or png", scales=by),
        Field("image", image, about="the encoded picture, byte for byte", scales=by, pictures=True),
    )


def _mark_fields(pictures: StoredPictures) -> tuple[Field, ...]:
    """What was seen in each kept picture, in pixels."""

    def points(name: str, most: int) -> ComputedColumn:
        return ComputedColumn(pictures, lambda some: _stacked([getattr(p.marks, name) for p in some], most))

    def point(name: str) -> ComputedColumn:
        return ComputedColumn(
            pictures, lambda some: np.array([getattr(p.marks, name) for p in some], np.float32).reshape(-1, 2)
        )

    corners, backbone = points("corners_px", pictures.corners), points("backbone_px", pictures.backbone)
    of_corners = "of the board: inner corners row by row, or of each tag the four, clockwise from its top left"
    by_corner, by_point, by_pixel = ("time", "corner", "pixel"), ("time", "point", "pixel"), ("time", "pixel")
    return (
        Field("pixel", ["u", "v"], about="to the right, down; 0 in the middle of the first pixel"),
        Field("corner", np.arange(1, pictures.corners + 1), about=of_corners, any_length=True),
        Field("point", np.arange(1, pictures.backbone + 1), about="from the base to the tip", any_length=True),
        Field("corners_px", corners, "px", "the board's corners as detected", by_corner),
        Field("tip_px", point("tip_px"), "px", "the measured tool centre point in this picture", by_pixel),
        Field("model_px", point("model_px"), "px", "the model's tool centre point in this picture", by_pixel),
        Field("backbone_px", backbone, "px", "the model's backbone in this picture", by_point),
    )


def _stacked(rows: Sequence[NDArray[np.float32]], most: int) -> NDArray[np.float32]:
    """Return point lists (n, 2) of at most so many points as one array (K, most, 2), NaN behind the shorter ones."""
    stack = np.full((len(rows), most, 2), np.nan, np.float32)
    for filled, row in zip(stack, rows, strict=True):
        filled[: len(row)] = row
    return stack


def _events(journal: Journal) -> Group:
    events = list(journal.events)
    if journal.footer is None:
        lost = "; ".join(map(str, journal.damage)) or "nothing"
        text = f"recovered from the journal; not readable: {lost}"
        events.append(Event(end_t_ns(journal), Level.WARNING, "recovery", text))
    by = ("time",)
    seconds = column_groups.seconds(journal, np.array([e.t_ns for e in events], np.int64))
    return Group(
        "entry/events",
        "NXcollection",
        (
            Field(
                "time",
                seconds,
                "s",
                "when it happened, since start_time",
                any_length=True,
            ),
            Field(
                "level",
                [str(e.level) for e in events],
                about="info, warning or fault",
                scales=by,
                among=tuple(Level),
            ),
            Field("source", [e.source for e in events], about="what reported it", scales=by),
            Field("message", [e.message for e in events], about="what happened", scales=by),
        ),
    )
