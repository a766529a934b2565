"""Records of a run, shared by the processes, the journal and the archive.

Rows are NumPy structured dtypes because they pass through shared memory; everything in them is SI. `runs.columns`
declares their fields.
Times are CLOCK_MONOTONIC nanoseconds (real time) or nanoseconds of virtual time; one wall-clock anchor per run
(`RunHeader.started_utc_ns` at `RunHeader.started_t_ns`) ties them to the calendar.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runs import columns
from runs.columns import BACKBONE_POINTS as BACKBONE_POINTS
from runs.columns import DATAGRAM_COUNTS as DATAGRAM_COUNTS
from runs.columns import DetectionStatus as DetectionStatus
from runs.columns import SolveStatus as SolveStatus
from runs.columns.declaration import Table

MODEL_ALONE = "model alone"
"""Executor of a simulation of the model, without a bench."""


class Status(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    INTERRUPTED = "interrupted"
    ABORTED = "aborted"
    RECOVERED = "recovered"


class Level(StrEnum):
    """Severity of an event."""

    INFO = "info"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True)
class Event:
    """An event of a run: armed, limit, abort, fault, recovered, prompt, operator's answer."""

    t_ns: int
    level: Level
    source: str
    message: str


@dataclass(frozen=True, eq=False)
class ImageAnnotations:
    """Annotations of a picture, in pixels (u, v): the board's corners (n, 2), the measured tip (2,), the
    model's tip (2,) and backbone (p, 2). NaN, or no corners, where there is none."""

    corners_px: NDArray[np.float32]
    tip_px: NDArray[np.float32]
    model_px: NDArray[np.float32]
    backbone_px: NDArray[np.float32]

    @classmethod
    def of(
        cls, corners_px: ArrayLike, tip_px: ArrayLike, model_px: ArrayLike, backbone_px: ArrayLike
    ) -> ImageAnnotations:
        """Annotations from arrays of any numeric type."""
        return cls(
            corners_px=np.asarray(corners_px, np.float32).reshape(-1, 2),
            tip_px=np.asarray(tip_px, np.float32),
            model_px=np.asarray(model_px, np.float32),
            backbone_px=np.asarray(backbone_px, np.float32).reshape(-1, 2),
        )

    @classmethod
    def none(cls) -> ImageAnnotations:
        """Empty annotations."""
        return cls.of([], [np.nan, np.nan], [np.nan, np.nan], [])


@dataclass(frozen=True)
class Picture:
    """One stored camera frame, encoded (`jpeg` or `png`), with its annotations."""

    t_ns: int
    frame: int
    camera: str
    encoding: str
    data: bytes | memoryview
    marks: ImageAnnotations = field(default_factory=ImageAnnotations.none)


@dataclass(frozen=True)
class PlayedSegment:
    """One segment of the protocol as it was played, in protocol time."""

    start_s: float
    stop_s: float
    kind: str
    label: str
    level_pa: tuple[float, ...]
    """Set-point of every actuator at the end of the segment."""


GRAVITY_DIRECTION = "gravity_direction"
SEGMENT = "segment_"
"""Before the number of a segment, in the names of what an arm of several has for each."""
"""Name of a quantity: a unit vector in the rod-base frame. In the room `calibration`, it was measured for the run."""


@dataclass(frozen=True)
class Quantity:
    """A number used by the run, with its source.

    `room` is `calibration`, `model`, `adaptation` or `protocol`; `uncertainty` is one standard deviation, NaN where it
    is not known.
    """

    room: str
    name: str
    value: tuple[float, ...]
    unit: str
    source: str
    uncertainty: float = float("nan")

    def __str__(self) -> str:
        values = ", ".join(f"{value:.12g}" for value in self.value)
        return f"{self.name} = {values}{f' {self.unit}' if self.unit else ''}"


@dataclass(frozen=True)
class AuxiliaryChannel:
    """An auxiliary input of the rig: a column of the samples."""

    name: str
    unit: str


@dataclass(frozen=True)
class SectionPlace:
    """A measured section of the arm: its name, and its arc length from the rod base at rest."""

    name: str
    at_mm: float


@dataclass(frozen=True)
class RecordedFile:
    """An input file of a run, verbatim: a calibration (its `kind`) or a CSV file of the protocol."""

    name: str
    kind: str
    sha256: str
    text: str

    @classmethod
    def of(cls, name: str, kind: str, text: str) -> RecordedFile:
        """A file with this text."""
        return cls(name, kind, hashlib.sha256(text.encode()).hexdigest(), text)


class StudyRole(StrEnum):
    """What a run is for in its study."""

    RUN = "run"
    CONDITIONING = "conditioning"


@dataclass(frozen=True)
class StudyRun:
    """The place of a run in its study. A conditioning run has the number of the run that follows it."""

    study: str
    role: StudyRole
    number: int
    """From 1, in the order of the study."""
    combination: int
    """From 1; runs of one combination have the same settings."""
    block: int
    plan_yaml: str
    sha256: str
    """Of everything that defines the study: plan, protocols, rig, specimen, real or virtual time."""


@dataclass(frozen=True)
class RunHeader:
    """Everything known before the first sample; the first record of the journal."""

    run_id: str
    title: str
    started_utc_ns: int
    started_t_ns: int
    protocol_name: str
    actuators: int
    valves: int
    executor: str
    """`real time` or `virtual time`."""
    simulated: bool
    """True if the card, a camera or the arm is simulated."""
    protocol_yaml: str = ""
    rig_name: str = ""
    rig_yaml: str = ""
    """The rig file as written; overlays are in `calibrations` and `parameters_yaml`."""
    seed: int | None = None
    model_variant: str = ""
    operator: str = ""
    notes: str = ""
    command: str = ""
    host: str = ""
    metadata: dict[str, str] = field(default_factory=dict)
    """Facts about the specimen and the user, by name: `specimen`, `batch`, .."""
    versions: dict[str, str] = field(default_factory=dict)
    git_commit: str = ""
    git_diff: str = ""
    intervals: tuple[PlayedSegment, ...] = ()
    quantities: tuple[Quantity, ...] = ()
    parent: str = ""
    """Run id of the replayed run; empty if this is not a replay."""
    protocol_files: tuple[RecordedFile, ...] = ()
    """The CSV files of the protocol, by their names in it."""
    calibrations: tuple[RecordedFile, ...] = ()
    """Calibration files applied to the rig, in this order."""
    parameters_yaml: str = ""
    """File of identified parameters applied after the calibrations, verbatim; empty without one."""
    adapted: tuple[Quantity, ...] = ()
    """Parameters of the recursive estimator: name, unit, start value and its uncertainty."""
    tip_controller: str = ""
    """Name of the tip controller; empty if the protocol has no tip reference."""
    learned_from: tuple[str, ...] = ()
    """Ids of the runs from which the tip controller has learned, in this order."""
    streams: bool = False
    """Whether the protocol has steps in which another program sends the set-points."""
    control_hz: float = 200.0
    camera_hz: float = 30.0
    cameras: tuple[str, ...] = ("camera",)
    """By name, in the order of the observations' columns."""
    sections: tuple[SectionPlace, ...] = ()
    """Measured sections of the arm, in the order of the observations' columns."""
    triggered: bool = False
    """Whether a card triggers the cameras."""
    tracker: str = ""
    """Name of the tracker that measures the tip; empty without one."""
    auxiliary: tuple[AuxiliaryChannel, ...] = ()
    """Auxiliary inputs, in the order of the samples' columns."""
    valve_units: tuple[str, ...] = ()
    """Units of the valves' outputs; empty if every valve takes a voltage."""
    study: StudyRun | None = None
    """None for a run that belongs to no study."""

    @property
    def measures_tip(self) -> bool:
        """True if a camera or a tracker measures the tip; without, the run has pressures and the model only."""
        return bool(self.cameras or self.tracker)

    @property
    def protocol_parameters(self) -> tuple[Quantity, ...]:
        """The parameters of the protocol, with the values that the run used."""
        return tuple(quantity for quantity in self.quantities if quantity.room == "protocol")

    @property
    def measured_gravity(self) -> Quantity | None:
        """The direction of gravity that was measured for this run, with the standard uncertainty across it [rad]."""
        found = [q for q in self.quantities if (q.room, q.name) == ("calibration", GRAVITY_DIRECTION)]
        return found[0] if found else None

    @property
    def inputs(self) -> dict[str, str]:
        """The texts that define the run, by what they are: protocol, rig file, and each overlay of the rig."""
        texts = {"protocol": self.protocol_yaml, "rig": self.rig_yaml}
        texts |= {f"calibration {file.name}": file.text for file in self.calibrations}
        texts["identified parameters"] = self.parameters_yaml
        return {name: text for name, text in texts.items() if text}


@dataclass(frozen=True)
class RunFooter:
    """How a run ended; it is created after the valves are in their safe state. A journal without one was cut off."""

    t_ns: int
    status: Status
    message: str
    counters: dict[str, int] = field(default_factory=dict)
    """Ring overflows, dropped frames, missed deadlines, stolen CPU time [ms], as the executor counted them."""


_ZERO = {c.record for table in columns.TABLES for c in table.columns() if c.record and c.missing == 0}
_SIZES = {axis: int(size) for axis, (size, _) in columns.AXES.items() if size.isdecimal()}
_SIZES["station"] = columns.BACKBONE_POINTS


def sample_dtype(actuators: int, valves: int, inputs: int = 0, outputs: bool = False) -> np.dtype[np.void]:
    """One control cycle: `Pressure` and `Timing`, and `Auxiliary` for a rig with auxiliary inputs.

    `outputs`: also `ValveOutput`, for a rig with a valve that takes another unit than V.

    `t_ns` is the time of the newest scan, `measured_pa` the mean of the `scans` scans since the last cycle,
    `valve_v` the voltage then commanded, NaN where an output is in another unit.
    """
    some = ((outputs, columns.ValveOutput), (inputs, columns.Auxiliary))
    tables = (columns.Pressure, columns.Timing, *(table for present, table in some if present))
    return _dtype(*tables, actuator=actuators, valve=valves, input=inputs)


def observation_dtype(
    actuators: int, cameras: int = 1, tracker: bool = False, triggered: bool = False, sections: int = 0
) -> np.dtype[np.void]:
    """One frame of every camera: `Tip`, `Backbone`, `Simulated`, `Reference` and `Learning`, in the rod-base frame.

    With a tracker: one reading, with `TrackerClock`. With triggered cameras: also `TriggeredFrame`. With measured
    sections: also `Sections`.

    `seen` is a `DetectionStatus`; where it is not MEASURED the measured columns are NaN. `truth_m` is NaN on a real
    rig. `age_ns` is the time from exposure to the end of the computation.
    """
    some = ((tracker, columns.TrackerClock), (triggered, columns.TriggeredFrame), (sections, columns.Sections))
    tables = (columns.Tip, columns.Backbone, columns.Simulated, columns.Reference, columns.Learning)
    every = (*tables, *(table for present, table in some if present))
    return _dtype(*every, actuator=actuators, camera=cameras, section=sections)


def adaptation_dtype(parameters: int) -> np.dtype[np.void]:
    """Result of the recursive estimator for one camera frame: `Adaptation`, in the order of `RunHeader.adapted`.

    `start_model_m` is the tip with the initial parameters; the observation's `model_m` is that with the estimates
    before the frame.
    """
    return _dtype(columns.Adaptation, parameter=parameters)


def tip_control_dtype(valves: int) -> np.dtype[np.void]:
    """One plan of the tip controller: `TipControl`."""
    return _dtype(columns.TipControl, valve=valves)


def pulse_dtype() -> np.dtype[np.void]:
    """One pulse of the camera trigger: `TriggerPulse`."""
    return _dtype(columns.TriggerPulse)


def streamed_dtype(actuators: int) -> np.dtype[np.void]:
    """One set-point of another program: `StreamedSetPoints`."""
    return _dtype(columns.StreamedSetPoints, actuator=actuators)


def _dtype(*tables: type[Table], **sizes: int) -> np.dtype[np.void]:
    known = _SIZES | sizes
    fields = {
        column.record: (column.record, column.dtype, tuple(known[axis] for axis in column.shape or column.axes))
        for table in tables
        for column in table.columns()
        if column.record
    }
    return np.dtype(list(fields.values()))


def blank(count: int | tuple[()], dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Return records (count,) in which no field is set: each is NaN, unless declared otherwise."""
    rows = np.zeros(count, dtype)
    for name in dtype.names or ():
        if dtype[name].base.kind == "f" and name not in _ZERO:
            rows[name] = np.nan
    return rows
