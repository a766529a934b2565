"""The kinds of rows in a journal, each declared once: its topic, its dtype, and which runs have it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from runs.records import (
    RunHeader,
    adaptation_dtype,
    observation_dtype,
    pulse_dtype,
    sample_dtype,
    streamed_dtype,
    tip_control_dtype,
)


@dataclass(frozen=True)
class RowKind:
    """One kind of row: its attribute of `Journal`, its MCAP channel, and its dtype by the header of the run."""

    name: str
    channel: int
    topic: str
    dtype: Callable[[RunHeader], np.dtype[np.void]]
    recorded: Callable[[RunHeader], bool] = lambda header: True
    """Whether a run has such rows."""


ROW_KINDS = (
    RowKind(
        "samples",
        4,
        "/samples",
        lambda h: sample_dtype(h.actuators, h.valves, len(h.auxiliary), bool(h.valve_units)),
    ),
    RowKind(
        "observations",
        5,
        "/observations",
        lambda h: observation_dtype(h.actuators, len(h.cameras), bool(h.tracker), h.triggered, len(h.sections)),
    ),
    RowKind("adaptations", 7, "/adaptations", lambda h: adaptation_dtype(len(h.adapted)), lambda h: bool(h.adapted)),
    RowKind("plans", 9, "/tip_control", lambda h: tip_control_dtype(h.valves), lambda h: bool(h.tip_controller)),
    RowKind("streamed", 10, "/stream", lambda h: streamed_dtype(h.actuators), lambda h: h.streams),
    RowKind("pulses", 11, "/trigger", lambda h: pulse_dtype(), lambda h: h.triggered),
)
