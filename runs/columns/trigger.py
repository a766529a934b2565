"""Columns of the pulses that trigger the cameras, and of the frames that they begin."""

from __future__ import annotations

from runs.columns.conversions import COUNT, time_column
from runs.columns.declaration import Column, Table


class TriggerPulse(Table):
    """Pulses of the camera trigger (g,). Only for rigs with a `trigger`."""

    group, rows, signal = "trigger", "G", "uncertainty_us"
    about = "one row per pulse; tip/frame is the number of the pulse that began the exposure"

    time_s = time_column("rising edge")
    pulse = Column("pulse", "<i8", about="number of the pulse")
    skipped = Column(
        "skipped", "<i4", about="frame periods without a pulse before this one, because control was late", limits=COUNT
    )
    uncertainty_us = Column(
        "write_s",
        unit="us",
        about="half of the duration of the write that set the output high",
        convert=lambda seconds: seconds * 0.5e6,
    )


class TriggeredFrame(Table):
    """What the pulses say of the camera frames (m, cameras), at the times of `Tip`. Only for rigs with a `trigger`."""

    group, rows, signal = "exposure", "M", "stamp_delay_us"
    about = "one row per camera frame of a rig with a trigger"

    time_s = time_column("middle of the exposure, by the pulse that began it")
    stamp_delay_us = Column(
        "stamp_delay_s",
        axes=("camera",),
        unit="us",
        about="time that the camera's driver gives, minus that by the pulse; NaN where a camera gave no picture",
        convert=lambda seconds: seconds * 1e6,
    )
    untriggered = Column(
        "untriggered",
        "<i4",
        axes=("camera",),
        about="pictures of the camera that no pulse began, since it was opened; they are not used",
        limits=COUNT,
    )
