"""Layout of an archive: a journal as NeXus groups and fields, in bar, mm and us.

The documentation for users is `docs/reference/archive.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from runs.archive import provenance
from runs.archive.fields import (
    LARGEST,
    LARGEST_NS,
    LARGEST_S,
    PA_PER_BAR,
    Column,
    Field,
    Group,
    Pictures,
    Table,
    named,
    row_chunks,
)
from runs.journal.journal import Journal
from runs.records import BACKBONE_POINTS, DetectionStatus, Event, Level, Status

VERSION = 2
"""Increased when a field moves or changes its meaning; readers refuse every other version."""

MM_PER_M = 1e3
MOST_CHANNELS = 4096
"""Most actuators, or valves, of an archive."""
UNITS = ("bar", "V", "mm", "mm2", "px", "us", "g", "N", "Nm")
"""Unit suffixes of column names."""
AXES = ("x", "y", "z")
SECONDS = (-LARGEST_S, LARGEST_S)
CLOCK = (0, LARGEST_NS)
OWN_CLOCK = (-LARGEST_NS, LARGEST_NS)
"""Imported data may count from any zero."""
COUNT = (0, LARGEST)
COVARIANCE = ("xx", "xy", "xz", "yy", "yz", "zz")
_UPPER = (np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2]))


def split_unit(name: str) -> tuple[str, str]:
    """Return a field's name without its unit, and the unit; `measured_mm` is `measured` in `mm`."""
    plain, _, unit = name.rpartition("_")
    return (plain, unit) if unit in UNITS else (name, "")


def groups(journal: Journal) -> tuple[Group, ...]:
    """Return every group of the archive of a journal."""
    return tuple(
        group
        for group in (
            _entry(journal),
            provenance.protocol(journal),
            provenance.rig(journal),
            provenance.protocol_files(journal),
            provenance.calibration_files(journal),
            provenance.versions(journal),
            provenance.git(journal),
            _pressure(journal),
            _tip(journal),
            _adaptation(journal),
            _timing(journal),
            _counters(journal),
            _frames(journal),
            _events(journal),
            provenance.quantities(journal, "calibration", "what was calibrated, as it was used"),
            provenance.quantities(journal, "model", "every number of the model, as it was used"),
            _backbone(journal),
            _simulator(journal),
        )
        if group is not None
    )


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


def _seconds(journal: Journal, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.asarray((t_ns - journal.header.started_t_ns) / 1e9)


def _time(journal: Journal, rows: Table, about: str) -> Field:
    seconds = Column(rows, lambda r: _seconds(journal, r["t_ns"]))
    return Field("time", seconds, "s", f"{about}, since start_time", finite=True, limits=SECONDS)


def _protocol_time(rows: Table) -> Field:
    about = "position in the protocol; stands still while the run waits for the operator"
    return Field("protocol_time", _plain(rows, "protocol_s"), "s", about, ("time",), limits=SECONDS)


def _scaled(rows: Table, name: str, factor: float) -> Column:
    return Column(rows, lambda r: r[name] * factor)


def _in_bar(rows: Table, name: str) -> Column:
    return Column(rows, lambda r: r[name] / PA_PER_BAR)


def _in_us(rows: Table, name: str) -> Column:
    return Column(rows, lambda r: r[name] / 1e3)


def _plain(rows: Table, name: str) -> Column:
    return Column(rows, itemgetter(name))


def _some(rows: Table, name: str) -> bool:
    """Return whether any number of a column is finite."""
    return any(bool(np.isfinite(chunk[name]).any()) for chunk in row_chunks(rows))


def _entry(journal: Journal) -> Group:
    header = journal.header
    end_ns = end_t_ns(journal)
    ended, message = status(journal)
    fields = [
        Field("title", header.title),
        Field("start_time", utc(header.started_utc_ns)),
        Field("end_time", utc(header.started_utc_ns + end_ns - header.started_t_ns)),
        Field("duration", (end_ns - header.started_t_ns) / 1e9, "s", finite=True, limits=SECONDS),
        Field("run_id", header.run_id),
        Field("status", str(ended), about="finished, interrupted, aborted or recovered", among=tuple(Status)),
        Field("message", message, about="why the run ended as it did"),
        Field(
            "simulated",
            np.int8(header.simulated),
            about="1 where the card, the camera or the arm was simulated",
            among=(0, 1),
        ),
        Field("executor", header.executor),
        Field("parent", header.parent, about="run that this replay was made from; empty for a run"),
        Field("operator", header.operator),
        Field("notes", header.notes),
        Field("command", header.command, about="the command line"),
        Field("host", header.host),
        Field("start_utc", np.int64(header.started_utc_ns), "ns", "start_time since 1970, exactly", limits=CLOCK),
        Field("start_clock", np.int64(header.started_t_ns), "ns", "start_time on the own clock", limits=OWN_CLOCK),
        Field("actuators", np.int32(header.actuators), limits=(0, MOST_CHANNELS)),
        Field("valves", np.int32(header.valves), limits=(0, MOST_CHANNELS)),
    ]
    if header.seed is not None:
        fields.append(Field("seed", np.int64(header.seed), about="of everything random in the simulator"))
    return Group("entry", "NXentry", tuple(fields), default="tip")


def _pressure(journal: Journal) -> Group:
    header, rows = journal.header, journal.samples
    per_actuator, per_valve = ("time", "actuator"), ("time", "valve")
    return Group(
        "entry/pressure",
        "NXdata",
        (
            _time(journal, rows, "when the newest scan of the tick was taken"),
            Field("actuator", np.arange(1, header.actuators + 1)),
            Field("valve", np.arange(1, header.valves + 1)),
            _protocol_time(rows),
            Field("setpoint_bar", _in_bar(rows, "setpoint_pa"), "bar", "gauge pressure asked for", per_actuator),
            Field("measured_bar", _in_bar(rows, "measured_pa"), "bar", "gauge, mean of the scans", per_actuator),
            Field("valve_V", _plain(rows, "valve_v"), "V", "voltage then commanded", per_valve),
            Field("scans", _plain(rows, "scans"), about="scans that the mean was taken over", scales=("time",)),
            Field("tick", _plain(rows, "tick"), about="number of the control tick", scales=("time",)),
        ),
        signal="measured_bar",
        axes=per_actuator,
        about="one row per control tick",
    )


def _tip(journal: Journal) -> Group:
    rows = journal.observations
    uncertainty = Column(rows, lambda r: _deviation(r["covariance_m2"]) * MM_PER_M)
    covariance = Column(rows, lambda r: r["covariance_m2"][:, _UPPER[0], _UPPER[1]] * MM_PER_M**2)
    error = Column(rows, lambda r: np.linalg.norm(r["measured_m"] * MM_PER_M - r["model_m"] * MM_PER_M, axis=1))
    by, per_axis = ("time",), ("time", "axis")
    seen = ", ".join(f"{s.value} {s.name.lower()}" for s in DetectionStatus)
    return Group(
        "entry/tip",
        "NXdata",
        (
            _time(journal, rows, "middle of the exposure"),
            Field("axis", list(AXES), about="of the rod-base frame"),
            Field("component", list(COVARIANCE)),
            Field("actuator", np.arange(1, journal.header.actuators + 1)),
            Field("camera", list(journal.header.cameras), about="names in the rig's YAML", any_length=True),
            _protocol_time(rows),
            Field(
                "measured_mm",
                _scaled(rows, "measured_m", MM_PER_M),
                "mm",
                "tool centre point seen by the camera, rod-base frame",
                per_axis,
            ),
            Field("uncertainty_mm", uncertainty, "mm", "standard, of measured_mm", per_axis),
            Field("covariance_mm2", covariance, "mm^2", "of measured_mm", ("time", "component")),
            Field(
                "model_mm",
                _scaled(rows, "model_m", MM_PER_M),
                "mm",
                "tool centre point by the model, rod-base frame",
                per_axis,
            ),
            Field("error_mm", error, "mm", "distance measured to model", by),
            Field("reprojection_px", _plain(rows, "reprojection_px"), "px", "rms over the board's corners", by),
            Field("frame", _plain(rows, "frame"), about="number of the camera's frame", scales=by),
            Field("weight_g", _scaled(rows, "weight_kg", 1e3), "g", "hung on the end cap by the operator", by),
            Field(
                "force_N",
                _plain(rows, "force_n"),
                "N",
                "measured, on the arm at the measured point; else zero",
                per_axis,
            ),
            Field(
                "moment_Nm",
                _plain(rows, "moment_n_m"),
                "N.m",
                "measured, about the measured point; else zero",
                per_axis,
            ),
            Field("pressure_bar", _in_bar(rows, "pressure_pa"), "bar", "given to the model", ("time", "actuator")),
            Field("seen", _plain(rows, "seen"), about=seen, scales=by, among=tuple(DetectionStatus)),
            Field("model_ok", _plain(rows, "model_ok"), about="0 where the model could not solve the step", scales=by),
            Field("age_us", _in_us(rows, "age_ns"), "us", "from exposure to result", by),
            Field("dropped", _plain(rows, "dropped"), about="frames lost before this one", scales=by, limits=COUNT),
            Field(
                "camera_seen",
                _plain(rows, "camera_seen"),
                about=f"by each camera: {seen}",
                scales=("time", "camera"),
                among=tuple(DetectionStatus),
            ),
            Field(
                "camera_skew_us", _scaled(rows, "camera_skew_s", 1e6), "us", "exposed after time", ("time", "camera")
            ),
        ),
        signal="error_mm",
        axes=by,
        about="one row per camera frame; NaN where nothing was measured",
    )


def _adaptation(journal: Journal) -> Group | None:
    adapted, rows = journal.header.adapted, journal.adaptations
    if not adapted:
        return None
    by, each = ("parameter",), ("time", "parameter")
    deviation = Column(rows, lambda r: _deviation(r["covariance"]))
    about = "tool centre point by the parameters that the run began with, rod-base frame"
    return Group(
        "entry/adaptation",
        "NXdata",
        (
            _time(journal, rows, "middle of the exposure"),
            Field(
                "parameter", [q.name for q in adapted], about="what is estimated while the run goes on", any_length=True
            ),
            Field("axis", list(AXES), about="of the rod-base frame"),
            Field("unit", [q.unit for q in adapted], about="of value, uncertainty and start", scales=by),
            Field("start", np.array([q.value[0] for q in adapted], float), about="value before the run", scales=by),
            Field("start_uncertainty", np.array([q.uncertainty for q in adapted], float), "", "standard, of start", by),
            Field("value", _plain(rows, "value"), about="estimate after the frame", scales=each),
            Field("uncertainty", deviation, about="standard, of value", scales=each),
            Field("covariance", _plain(rows, "covariance"), about="of value", scales=(*each, "parameter")),
            Field("frame", _plain(rows, "frame"), about="as tip/frame", scales=("time",)),
            Field(
                "used",
                _plain(rows, "used"),
                about="1; 0 where the frame told nothing, 2 where it counted less",
                scales=("time",),
            ),
            Field("start_model_mm", _scaled(rows, "start_model_m", MM_PER_M), "mm", about, ("time", "axis")),
        ),
        signal="value",
        axes=each,
        about="parameters estimated beside the run; never used for control",
    )


def _backbone(journal: Journal) -> Group | None:
    rows = journal.observations
    if not _some(rows, "backbone_m"):
        return None
    line = Column(rows, lambda r: r["backbone_m"] * np.float32(MM_PER_M))
    per_point = ("time", "station", "axis")
    return Group(
        "entry/backbone",
        "NXdata",
        (
            _time(journal, rows, "middle of the exposure"),
            Field(
                "station", np.linspace(0, 1, BACKBONE_POINTS), about="share of the arm's length at rest, from the base"
            ),
            Field("axis", list(AXES), about="of the rod-base frame"),
            Field("model_mm", line, "mm", "centre line by the model, rod-base frame", per_point),
        ),
        signal="model_mm",
        axes=per_point,
        about="one row per camera frame; NaN where the model could not solve the step",
    )


def _timing(journal: Journal) -> Group:
    rows = journal.samples
    overflows = sum(count for name, count in _counted(journal).items() if name.endswith("ring_overflows"))
    dropped = sum(int(chunk["dropped"].sum()) for chunk in row_chunks(journal.observations))
    return Group(
        "entry/timing",
        "NXdata",
        (
            _time(journal, rows, "when the newest scan of the tick was taken"),
            Field("lateness_us", _in_us(rows, "lateness_ns"), "us", "how late the control tick began", ("time",)),
            Field("overruns", _plain(rows, "missed"), about="deadlines missed since the last tick", scales=("time",)),
            Field("dropped_frames", np.int64(dropped), about="camera frames lost", limits=COUNT),
            Field("ring_overflows", np.int64(overflows), about="rows lost in shared memory", limits=COUNT),
            Field("control_rate", journal.header.control_hz, "Hz", "asked for"),
            Field("camera_rate", journal.header.camera_hz, "Hz", "asked for"),
        ),
        signal="lateness_us",
        axes=("time",),
    )


def _counted(journal: Journal) -> dict[str, int]:
    return journal.footer.counters if journal.footer else {}


def _counters(journal: Journal) -> Group:
    counters = _counted(journal)
    fields = (Field(name, np.int64(count)) for name, count in sorted(counters.items()))
    return Group(
        "entry/timing/counters", "NXcollection", named(fields), about="as the executor counted them", open=True
    )


def _frames(journal: Journal) -> Group:
    pictures = journal.pictures
    by = ("time",)

    def points(name: str, most: int) -> Column:
        return Column(pictures, lambda some: _stacked([getattr(p.marks, name) for p in some], most))

    def point(name: str) -> Column:
        return Column(
            pictures, lambda some: np.array([getattr(p.marks, name) for p in some], np.float32).reshape(-1, 2)
        )

    seconds = Column(pictures, lambda some: _seconds(journal, np.array([p.t_ns for p in some], np.int64)))
    index = Column(pictures, lambda some: np.array([p.frame for p in some], np.int64))
    return Group(
        "entry/frames",
        "NXcollection",
        (
            Field("time", seconds, "s", "middle of the exposure, since start_time", finite=True, limits=SECONDS),
            Field("index", index, about="as tip/frame", scales=by),
            Field("camera", Column(pictures, lambda some: [p.camera for p in some]), scales=by),
            Field(
                "encoding", Column(pictures, lambda some: [p.encoding for p in some]), about="jpeg or png", scales=by
            ),
            Pictures(
                "image",
                Column(pictures, lambda some: [p.data for p in some]),
                by,
                "the encoded picture, byte for byte",
            ),
            Field("pixel", ["u", "v"], about="to the right, down; 0 in the middle of the first pixel"),
            Field("corner", np.arange(1, pictures.corners + 1), about="of the board, row by row", any_length=True),
            Field("point", np.arange(1, pictures.backbone + 1), about="from the base to the tip", any_length=True),
            Field(
                "corners_px",
                points("corners_px", pictures.corners),
                "px",
                "the board's corners as detected",
                ("time", "corner", "pixel"),
            ),
            Field("tip_px", point("tip_px"), "px", "the measured tool centre point in this picture", ("time", "pixel")),
            Field(
                "model_px", point("model_px"), "px", "the model's tool centre point in this picture", ("time", "pixel")
            ),
            Field(
                "backbone_px",
                points("backbone_px", pictures.backbone),
                "px",
                "the model's backbone in this picture",
                ("time", "point", "pixel"),
            ),
        ),
        about="the kept pictures and what was seen in them; NaN where there was nothing",
    )


def _deviation(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the square roots of the diagonals of covariances (n, p, p)."""
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


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
    seconds = _seconds(journal, np.array([e.t_ns for e in events], np.int64))
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
                finite=True,
                limits=SECONDS,
            ),
            Field(
                "level",
                [str(e.level) for e in events],
                about="info, warning or fault",
                scales=by,
                among=tuple(Level),
            ),
            Field("source", [e.source for e in events], scales=by),
            Field("message", [e.message for e in events], scales=by),
        ),
    )


def _simulator(journal: Journal) -> Group | None:
    rows = journal.observations
    if not journal.header.simulated or not _some(rows, "truth_m"):
        return None
    about = "SIMULATED: the simulator's own tool centre point, which no camera saw; rod-base frame"
    return Group(
        "entry/simulator",
        "NXdata",
        (
            _time(journal, rows, "middle of the exposure"),
            Field("axis", list(AXES), about="of the rod-base frame"),
            Field("tip_mm", _scaled(rows, "truth_m", MM_PER_M), "mm", about, ("time", "axis")),
        ),
        signal="tip_mm",
        axes=("time", "axis"),
        about="SIMULATED truth; measurements stand in /entry/tip",
    )
