"""Columns of a tracker: how the times of its messages were obtained, and which messages were not used."""

from __future__ import annotations

from runs.columns.conversions import time_column
from runs.columns.declaration import Column, Table

DATAGRAM_COUNTS = ("lost", "doubled", "reordered", "late", "malformed", "foreign", "implausible", "clock_steps")
"""What is counted of a tracker's messages: those that were not used, by reason, and steps of the sender's clock."""


class TrackerClock(Table):
    """Clock of a tracker and counts of its messages (m, ..), at the times of `Tip`."""

    group, rows, signal = "tracker", "M", "clock_offset_s"
    about = "one row per observation of a rig with a tracker; NaN where no message came"

    time_s = time_column("of the pose, on the own clock")
    clock_offset_s = Column(
        "clock_offset_s", unit="s", about="own time minus the sender's; contains the constant part of the delay"
    )
    clock_drift_ppm = Column(
        "clock_drift",
        unit="1e-6",
        about="change of the offset per time of the sender",
        convert=lambda drift: drift * 1e6,
    )
    clock_uncertainty_us = Column(
        "clock_std_s", unit="us", about="standard uncertainty of the offset's estimate", convert=lambda s: s * 1e6
    )
    time_uncertainty_us = Column(
        "time_std_s",
        unit="us",
        about="standard uncertainty of the time, with that of the constant delay",
        convert=lambda s: s * 1e6,
    )
    messages = Column(
        "datagrams", "<i8", axes=("count",), about="messages that were not used and steps of the clock, since the start"
    )
