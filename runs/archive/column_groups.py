"""The groups of an archive that hold the declared columns (`runs.columns`): one dataset for each, and its scales."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runs import columns
from runs.archive.fields import ComputedColumn, Field, Group, RowTable, Value, row_chunks
from runs.columns.declaration import Column, Table
from runs.journal.journal import Journal


@dataclass(frozen=True)
class TableGroup:
    """The group of one table: the rows that it is computed from, the runs that have it, and its other datasets."""

    kind: type[Table]
    rows: str
    """Attribute of the journal."""
    present: Callable[[Journal], object] = lambda journal: True
    facts: Callable[[Journal], tuple[Field, ...]] = lambda journal: ()

    def of(self, journal: Journal) -> Group | None:
        """Return the group of a journal's archive; None for a run without it."""
        if not self.present(journal):
            return None
        kind, rows = self.kind, getattr(journal, self.rows)
        # Without cameras there are no columns per camera: HDF5 keeps no empty dimension.
        declared = [c for c in kind.columns() if "camera" not in c.axes or journal.header.cameras]
        axes = dict.fromkeys(axis for column in declared for axis in column.axes)
        plotted = next(column for column in declared if column.dataset == kind.signal)
        fields = (*(_field(journal, column, rows) for column in declared), *(_scale(journal, axis) for axis in axes))
        return Group(
            f"entry/{kind.group}",
            "NXdata",
            (*fields, *self.facts(journal)),
            signal=kind.signal,
            axes=("time", *plotted.axes),
            about=kind.about,
        )


def _input_units(journal: Journal) -> tuple[Field, ...]:
    units = [one.unit for one in journal.header.auxiliary]
    return (Field("input_unit", units, about="unit of each column of value", scales=("input",)),)


def _valve_units(journal: Journal) -> tuple[Field, ...]:
    units = list(journal.header.valve_units)
    return (Field("valve_unit", units, about="unit of each column of output", scales=("valve",)),)


def _tracker_name(journal: Journal) -> tuple[Field, ...]:
    return (Field("name", journal.header.tracker, about="of the tracker in the rig file"),)


def _section_places(journal: Journal) -> tuple[Field, ...]:
    at_mm = np.array([place.at_mm for place in journal.header.sections])
    about = "arc length from the rod base, of the arm at rest"
    return (Field("at_mm", at_mm, "mm", about, scales=("section",)),)


def _initial_parameters(journal: Journal) -> tuple[Field, ...]:
    adapted, by = journal.header.adapted, ("parameter",)
    start = np.array([q.value[0] for q in adapted], float)
    deviation = np.array([q.uncertainty for q in adapted], float)
    return (
        Field("unit", [q.unit for q in adapted], about="unit of start, value and their uncertainties", scales=by),
        Field("start", start, about="initial value", scales=by),
        Field("start_uncertainty", deviation, about="one standard deviation of the prior", scales=by),
    )


def _controller_name(journal: Journal) -> tuple[Field, ...]:
    about = "name of the tip controller, or package:Class"
    return (Field("controller", journal.header.tip_controller, about=about),)


def _earlier_runs(journal: Journal) -> tuple[Field, ...]:
    return (Field("run", list(journal.header.learned_from), about="ids of the earlier runs", any_length=True),)


def _losses(journal: Journal) -> tuple[Field, ...]:
    """Return the losses of the whole run, and the nominal rates."""
    header, counters = journal.header, journal.footer.counters if journal.footer else {}
    overflows = sum(count for name, count in counters.items() if name.endswith("ring_overflows"))
    dropped = sum(int(chunk["dropped"].sum()) for chunk in row_chunks(journal.observations))
    about = "camera frames or messages of the tracker lost, over the run"
    frames = (Field("dropped_frames", np.int64(dropped), about=about),) if header.measures_tip else ()
    about = "nominal; that of the tracker or, without both, of the model"
    return (
        *frames,
        Field("ring_overflows", np.int64(overflows), about="rows lost in shared memory, over the run"),
        Field("control_rate", header.control_hz, "Hz", "nominal"),
        Field("camera_rate", header.camera_hz, "Hz", about),
    )


def _has_numbers(name: str) -> Callable[[Journal], bool]:
    """Return the condition that a field of the observations has a finite number."""
    return lambda journal: any(bool(np.isfinite(chunk[name]).any()) for chunk in row_chunks(journal.observations))


def _has_reference(journal: Journal) -> bool:
    return any(bool(chunk["tip_motion"].any()) for chunk in row_chunks(journal.observations))


TABLE_GROUPS = (
    TableGroup(columns.Pressure, "samples"),
    TableGroup(columns.ValveOutput, "samples", lambda j: j.header.valve_units, _valve_units),
    TableGroup(columns.Auxiliary, "samples", lambda j: j.header.auxiliary, _input_units),
    TableGroup(columns.Tip, "observations"),
    TableGroup(columns.TrackerClock, "observations", lambda j: j.header.tracker, _tracker_name),
    TableGroup(columns.TriggerPulse, "pulses", lambda j: j.header.triggered),
    TableGroup(columns.TriggeredFrame, "observations", lambda j: j.header.triggered),
    TableGroup(columns.Sections, "observations", lambda j: j.header.sections, _section_places),
    TableGroup(columns.Adaptation, "adaptations", lambda j: j.header.adapted, _initial_parameters),
    TableGroup(columns.TipControl, "plans", lambda j: j.header.tip_controller, _controller_name),
    TableGroup(columns.StreamedSetPoints, "streamed", lambda j: j.header.streams),
    TableGroup(columns.Timing, "samples", facts=_losses),
    TableGroup(columns.Backbone, "observations", _has_numbers("backbone_m")),
    TableGroup(columns.Simulated, "observations", lambda j: j.header.simulated and _has_numbers("truth_m")(j)),
    TableGroup(columns.Reference, "observations", _has_reference),
    TableGroup(columns.Learning, "observations", lambda j: j.header.learned_from, _earlier_runs),
)


def seconds(journal: Journal, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return times [s] since the start of the run."""
    return np.asarray((t_ns - journal.header.started_t_ns) / 1e9)


def clock_ns(time_s: NDArray[np.float64] | float, started_t_ns: int) -> NDArray[np.int64]:
    """Return the times on the own clock [ns] of times [s] since the start of a run: the inverse of `seconds`."""
    return np.round(np.asarray(time_s) * 1e9).astype(np.int64) + started_t_ns


def _field(journal: Journal, column: Column, rows: RowTable) -> Field:
    clock = column.record == "t_ns"
    return Field(
        column.dataset,
        ComputedColumn(rows, lambda chunk: seconds(journal, chunk["t_ns"]) if clock else column.stored(chunk)),
        column.unit,
        column.about,
        () if clock else ("time", *column.axes),
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
