"""The NumPy dtypes of the records, from the declared columns."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from runs.columns import (
    ADAPTATIONS,
    AUXILIARY,
    BACKBONE_POINTS,
    DATAGRAM_COUNTS,
    OBSERVATIONS,
    PLAN_AHEAD_S,
    SAMPLES,
    SECTIONS,
    STREAMED,
    TIP_CONTROL,
    TRACKED,
    TRIGGER_PULSES,
    TRIGGERED,
)
from runs.columns.declaration import Table

_ZERO = {
    c.record
    for t in (
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
    for c in t.columns()
    if c.record and c.missing == 0
}
_SIZES = {"axis": 3, "turn": 3, "ahead": len(PLAN_AHEAD_S), "station": BACKBONE_POINTS, "count": len(DATAGRAM_COUNTS)}


def sample_dtype(actuators: int, valves: int, inputs: int = 0) -> np.dtype[np.void]:
    """One control cycle: `Pressure` and `Timing`, and `Auxiliary` for a rig with auxiliary inputs.

    `t_ns` is the time of the newest scan, `measured_pa` the mean of the `scans` scans since the last cycle,
    `valve_v` the voltage then commanded, NaN where an output is in another unit.
    """
    return _dtype((*SAMPLES, *(AUXILIARY if inputs else ())), actuator=actuators, valve=valves, input=inputs)


def observation_dtype(
    actuators: int, cameras: int = 1, tracker: bool = False, triggered: bool = False, sections: int = 0
) -> np.dtype[np.void]:
    """One frame of every camera: `Tip`, `Backbone`, `Simulated`, `Reference` and `Learning`, in the rod-base frame.

    With a tracker: one reading, with `TrackerClock`. With triggered cameras: also `TriggeredFrame`. With measured
    sections: also `Sections`.

    `seen` is a `DetectionStatus`; where it is not MEASURED the measured columns are NaN. `truth_m` is NaN on a real
    rig. `age_ns` is the time from exposure to the end of the computation.
    """
    tables = (*OBSERVATIONS, *(TRACKED if tracker else ()), *(TRIGGERED if triggered else ()))
    return _dtype((*tables, *(SECTIONS if sections else ())), actuator=actuators, camera=cameras, section=sections)


def adaptation_dtype(parameters: int) -> np.dtype[np.void]:
    """Result of the recursive estimator for one camera frame: `Adaptation`, in the order of `RunHeader.adapted`.

    `start_model_m` is the tip with the initial parameters; the observation's `model_m` is that with the estimates
    before the frame.
    """
    return _dtype(ADAPTATIONS, parameter=parameters)


def tip_control_dtype(valves: int) -> np.dtype[np.void]:
    """One plan of the tip controller: `TipControl`."""
    return _dtype(TIP_CONTROL, valve=valves)


def pulse_dtype() -> np.dtype[np.void]:
    """One pulse of the camera trigger: `TriggerPulse`."""
    return _dtype(TRIGGER_PULSES)


def streamed_dtype(actuators: int) -> np.dtype[np.void]:
    """One set-point of another program: `StreamedSetPoints`."""
    return _dtype(STREAMED, actuator=actuators)


def _dtype(tables: Iterable[type[Table]], **sizes: int) -> np.dtype[np.void]:
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
