"""Columns of the set-points that another program sends during a run."""

from __future__ import annotations

from enum import IntEnum

from runs.columns.conversions import from_bar, protocol_time_column, time_column, to_bar
from runs.columns.declaration import Column, Table


class StreamStatus(IntEnum):
    """What became of a streamed set-point."""

    FOLLOWED = 0
    OUT_OF_LIMITS = 1
    """Not a finite number, outside the pressure limits of the rig, or unequal for actuators on one valve."""
    OUT_OF_ORDER = 2
    """Its sequence number is not above that of the one before."""
    NOT_NOW = 3
    """The protocol is at another step, or paused."""
    OTHER_CLIENT = 4
    """Another program sends the set-points of this step."""


class StreamedSetPoints(Table):
    """Set-points that another program has sent (s,), per actuator (s, N). Only for protocols with a step `stream`."""

    group, rows, signal = "stream", "T", "setpoint_bar"
    about = "one row per set-point of another program, refused ones too; what was followed is in /entry/pressure"

    time_s = time_column("arrival of the set-point")
    protocol_s = protocol_time_column()
    connection = Column("connection", "<i4", about="number of the connection, from 1")
    sequence = Column("sequence", "<i8", about="sequence number, as it was sent; what is missing was lost before")
    setpoint_bar = Column(
        "setpoint_pa",
        axes=("actuator",),
        unit="bar",
        about="set-point as it was sent; NaN if infinite or no number, and for actuators that the step does not name",
        convert=to_bar,
        inverse=from_bar,
    )
    status = Column(
        "status",
        "<i4",
        about=", ".join(f"{s.value} {s.name.lower()}" for s in StreamStatus),
        among=tuple(StreamStatus),
    )
    late_ms = Column(
        "late_s",
        unit="ms",
        about="from the arrival to the control cycle that took it",
        convert=lambda s: s * 1e3,
        inverse=lambda ms: ms / 1e3,
    )
