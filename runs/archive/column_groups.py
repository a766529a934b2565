"""The groups of an archive that hold the declared columns (`runs.columns`): one dataset for each, and its scales."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from runs import columns
from runs.archive.fields import ComputedColumn, Field, Group, RowTable, Value, row_chunks
from runs.columns.declaration import Column, Table
from runs.journal.journal import Journal


def pressure(journal: Journal) -> Group:
    """Return the control cycles."""
    return _group(journal, columns.Pressure, journal.samples)


def timing(journal: Journal, losses: tuple[Field, ...]) -> Group:
    """Return the timing of the control cycles, and the losses of the whole run."""
    return _group(journal, columns.Timing, journal.samples, losses)


def auxiliary(journal: Journal) -> Group | None:
    """Return the auxiliary inputs; None for a rig without any."""
    inputs = journal.header.auxiliary
    if not inputs:
        return None
    units = Field("input_unit", [one.unit for one in inputs], about="unit of each column of value", scales=("input",))
    return _group(journal, columns.Auxiliary, journal.samples, (units,))


def tip(journal: Journal) -> Group:
    """Return the camera frames."""
    return _group(journal, columns.Tip, journal.observations)


def tracker(journal: Journal) -> Group | None:
    """Return the clock and the counts of the tracker; None without one."""
    if not journal.header.tracker:
        return None
    name = Field("name", journal.header.tracker, about="of the tracker in the rig file")
    return _group(journal, columns.TrackerClock, journal.observations, (name,))


def backbone(journal: Journal) -> Group | None:
    """Return the model's centre lines; None if there are none."""
    rows = journal.observations
    return _group(journal, columns.Backbone, rows) if _some(rows, "backbone_m") else None


def simulator(journal: Journal) -> Group | None:
    """Return the simulator's truth; None without a simulator."""
    rows = journal.observations
    simulated = journal.header.simulated and _some(rows, "truth_m")
    return _group(journal, columns.Simulated, rows) if simulated else None


def reference(journal: Journal) -> Group | None:
    """Return the reference of the tip; None without one."""
    rows = journal.observations
    some = any(bool(chunk["tip_motion"].any()) for chunk in row_chunks(rows))
    return _group(journal, columns.Reference, rows) if some else None


def learning(journal: Journal) -> Group | None:
    """Return what was learned from earlier runs; None without any."""
    if not journal.header.learned_from:
        return None
    runs = Field("run", list(journal.header.learned_from), about="ids of the earlier runs", any_length=True)
    return _group(journal, columns.Learning, journal.observations, (runs,))


def adaptation(journal: Journal) -> Group | None:
    """Return the results of the recursive estimator; None without one."""
    adapted = journal.header.adapted
    if not adapted:
        return None
    by = ("parameter",)
    start = np.array([q.value[0] for q in adapted], float)
    deviation = np.array([q.uncertainty for q in adapted], float)
    facts = (
        Field("unit", [q.unit for q in adapted], about="unit of start, value and their uncertainties", scales=by),
        Field("start", start, about="initial value", scales=by),
        Field("start_uncertainty", deviation, about="one standard deviation of the prior", scales=by),
    )
    return _group(journal, columns.Adaptation, journal.adaptations, facts)


def tip_control(journal: Journal) -> Group | None:
    """Return the plans of the tip controller; None without one."""
    if not journal.header.tip_controller:
        return None
    name = Field("controller", journal.header.tip_controller, about="name of the tip controller, or package:Class")
    return _group(journal, columns.TipControl, journal.plans, (name,))


def stream(journal: Journal) -> Group | None:
    """Return the set-points of another program; None for a protocol without a step `stream`."""
    return _group(journal, columns.StreamedSetPoints, journal.streamed) if journal.header.streams else None


def trigger(journal: Journal) -> Group | None:
    """Return the pulses of the camera trigger; None for a rig without one."""
    return _group(journal, columns.TriggerPulse, journal.pulses) if journal.header.triggered else None


def exposure(journal: Journal) -> Group | None:
    """Return what the pulses say of the frames; None for a rig without a camera trigger."""
    return _group(journal, columns.TriggeredFrame, journal.observations) if journal.header.triggered else None


def sections(journal: Journal) -> Group | None:
    """Return the measured sections of the arm; None without any."""
    places = journal.header.sections
    if not places:
        return None
    at_mm = np.array([place.at_mm for place in places])
    about = "arc length from the rod base, of the arm at rest"
    place = Field("at_mm", at_mm, "mm", about, scales=("section",))
    return _group(journal, columns.Sections, journal.observations, (place,))


def seconds(journal: Journal, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return times [s] since the start of the run."""
    return np.asarray((t_ns - journal.header.started_t_ns) / 1e9)


def _group(journal: Journal, kind: type[Table], rows: RowTable, facts: tuple[Field, ...] = ()) -> Group:
    # Without cameras there are no columns per camera: HDF5 keeps no empty dimension.
    declared = [c for c in kind.columns() if "camera" not in c.axes or journal.header.cameras]
    axes = dict.fromkeys(axis for column in declared for axis in column.axes)
    plotted = next(column for column in declared if column.dataset == kind.signal)
    return Group(
        f"entry/{kind.group}",
        "NXdata",
        (*(_field(journal, column, rows) for column in declared), *(_scale(journal, axis) for axis in axes), *facts),
        signal=kind.signal,
        axes=("time", *plotted.axes),
        about=kind.about,
    )


def _field(journal: Journal, column: Column, rows: RowTable) -> Field:
    clock = column.record == "t_ns"
    return Field(
        column.dataset,
        ComputedColumn(rows, lambda chunk: seconds(journal, chunk["t_ns"]) if clock else column.stored(chunk)),
        column.unit,
        column.about,
        () if clock else ("time", *column.axes),
        finite=column.finite,
        limits=column.limits,
        among=column.among,
        since=column.since,
    )


def _scale(journal: Journal, axis: str) -> Field:
    """Return the scale that labels a dimension of the columns."""
    header = journal.header
    values: dict[str, Value] = {
        "axis": ["x", "y", "z"],
        "ahead": np.array(columns.PLAN_AHEAD_S),
        "turn": ["rx", "ry", "rz"],
        "component": ["xx", "xy", "xz", "yy", "yz", "zz"],
        "actuator": np.arange(1, header.actuators + 1),
        "valve": np.arange(1, header.valves + 1),
        "input": [one.name for one in header.auxiliary],
        "count": list(columns.DATAGRAM_COUNTS),
        "camera": list(header.cameras),
        "station": np.linspace(0, 1, columns.BACKBONE_POINTS),
        "section": [place.name for place in header.sections],
        "parameter": [q.name for q in header.adapted],
    }
    return Field(
        axis, values[axis], about=columns.AXES[axis][1], any_length=axis in ("camera", "input", "parameter", "section")
    )


def _some(rows: RowTable, name: str) -> bool:
    """Return whether any number of a field is finite."""
    return any(bool(np.isfinite(chunk[name]).any()) for chunk in row_chunks(rows))
