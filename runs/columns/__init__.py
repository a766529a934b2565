"""The columns of a run, each declared once.

From a declaration follow: the field of the record that passes through shared memory and the journal, the dataset of the
archive with its unit, description and checks, the attribute of `runs.open(..)`, the columns of every export, and the
row in `docs/reference/archive.md` (`python -m runs.archive.reference docs/reference/archive.md` writes it).
"""

from __future__ import annotations

from runs.columns.control_cycles import Auxiliary, Pressure, Timing, TriggerPulse, ValveOutput
from runs.columns.declaration import Column, Table
from runs.columns.observations import (
    BACKBONE_POINTS,
    DATAGRAM_COUNTS,
    Adaptation,
    Backbone,
    DetectionStatus,
    Sections,
    Simulated,
    Tip,
    TrackerClock,
    TriggeredFrame,
)
from runs.columns.streamed import StreamedSetPoints, StreamStatus
from runs.columns.tip_control import FOLLOWED_S, PLAN_AHEAD_S, Learning, Reference, SolveStatus, TipControl

__all__ = [
    "AXES",
    "BACKBONE_POINTS",
    "DATAGRAM_COUNTS",
    "FOLLOWED_S",
    "PLAN_AHEAD_S",
    "TABLES",
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
    "ValveOutput",
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

TABLES: tuple[type[Table], ...] = (
    Pressure,
    Timing,
    ValveOutput,
    Auxiliary,
    Tip,
    Backbone,
    Simulated,
    Reference,
    Learning,
    TrackerClock,
    TriggeredFrame,
    Sections,
    TriggerPulse,
    Adaptation,
    TipControl,
    StreamedSetPoints,
)
