"""The columns of a run, each declared once.

From a declaration follow: the field of the record that passes through shared memory and the journal, the dataset of the
archive with its unit, description and checks, the attribute of `runs.open(..)`, the columns of every export, and the
row in `docs/reference/archive.md` (`python -m runs.archive.reference docs/reference/archive.md` writes it).
"""

from __future__ import annotations

from runs.columns.adaptation import Adaptation
from runs.columns.control_cycles import Auxiliary, Pressure, Timing
from runs.columns.conversions import COUNT, SECONDS
from runs.columns.declaration import Column, Table
from runs.columns.observations import BACKBONE_POINTS, Backbone, DetectionStatus, Simulated, Tip
from runs.columns.sections import Sections
from runs.columns.streamed import StreamedSetPoints, StreamStatus
from runs.columns.tip_control import PLAN_AHEAD_S, Learning, Reference, SolveStatus, TipControl
from runs.columns.tracker import DATAGRAM_COUNTS, TrackerClock
from runs.columns.trigger import TriggeredFrame, TriggerPulse

__all__ = [
    "ADAPTATIONS",
    "AUXILIARY",
    "AXES",
    "BACKBONE_POINTS",
    "COUNT",
    "DATAGRAM_COUNTS",
    "OBSERVATIONS",
    "PLAN_AHEAD_S",
    "SAMPLES",
    "SECONDS",
    "SECTIONS",
    "STREAMED",
    "TABLES",
    "TIP_CONTROL",
    "TRACKED",
    "TRIGGERED",
    "TRIGGER_PULSES",
    "Adaptation",
    "Auxiliary",
    "Backbone",
    "Column",
    "DetectionStatus",
    "Learning",
    "Pressure",
    "Reference",
    "Sections",
    "Simulated",
    "SolveStatus",
    "StreamStatus",
    "StreamedSetPoints",
    "Table",
    "Timing",
    "Tip",
    "TipControl",
    "TrackerClock",
    "TriggerPulse",
    "TriggeredFrame",
]

AXES = {
    "ahead": (str(len(PLAN_AHEAD_S)), "time [s] after the start of the plan"),
    "axis": ("3", "x, y, z of the rod-base frame"),
    "turn": ("3", "small rotations about x, y, z of the rod-base frame"),
    "component": ("6", "names of the covariance's columns"),
    "actuator": ("A", "1, 2, .."),
    "valve": ("V", "1, 2, .."),
    "input": ("I", "names of the auxiliary inputs in the rig file"),
    "count": (str(len(DATAGRAM_COUNTS)), "names of the counts"),
    "camera": ("C", "names of the cameras in the rig file"),
    "station": ("L", "0 to 1, share of the length of the arm at rest"),
    "section": ("B", "names of the measured sections in the rig file"),
    "parameter": ("P", "its name, as in `rig identify --free`"),
}
"""Size of each axis in the reference page, and what its scale holds."""

SAMPLES: tuple[type[Table], ...] = (Pressure, Timing)
AUXILIARY: tuple[type[Table], ...] = (Auxiliary,)
OBSERVATIONS: tuple[type[Table], ...] = (Tip, Backbone, Simulated, Reference, Learning)
TRACKED: tuple[type[Table], ...] = (TrackerClock,)
TRIGGERED: tuple[type[Table], ...] = (TriggeredFrame,)
SECTIONS: tuple[type[Table], ...] = (Sections,)
TRIGGER_PULSES: tuple[type[Table], ...] = (TriggerPulse,)
ADAPTATIONS: tuple[type[Table], ...] = (Adaptation,)
TIP_CONTROL: tuple[type[Table], ...] = (TipControl,)
STREAMED: tuple[type[Table], ...] = (StreamedSetPoints,)
"""The tables of each record."""
TABLES = (
    *SAMPLES,
    *AUXILIARY,
    *OBSERVATIONS,
    *TRACKED,
    *TRIGGERED,
    *SECTIONS,
    *TRIGGER_PULSES,
    *ADAPTATIONS,
    *TIP_CONTROL,
    *STREAMED,
)
