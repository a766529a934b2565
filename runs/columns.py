"""The columns of a run, each declared once.

From a declaration follow: the field of the record that passes through shared memory and the journal, the dataset of the
archive with its unit, description and checks, the attribute of `runs.open(..)`, the columns of every export, and the
row in `docs/reference/archive.md` (`python -m runs.archive.reference docs/reference/archive.md` writes it).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from runs.archive.fields import LARGEST, LARGEST_S, PA_PER_BAR
from runs.column_declaration import Column, Table, Values

BACKBONE_POINTS = 11
"""Points of the model's backbone, evenly spaced along the arm at rest."""
MM_PER_M = 1e3
SECONDS = (-LARGEST_S, LARGEST_S)
COUNT = (0.0, LARGEST)
_UPPER = (np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2]))
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class DetectionStatus(IntEnum):
    """Result of the tip measurement in a frame."""

    MEASURED = 0
    NO_BOARD = 1
    AMBIGUOUS = 2
    POOR_FIT = 3
    NO_FRAME = 4
    DISAGREE = 5
    NO_CAMERA = 6


class SolveStatus(IntEnum):
    """How the tip controller found a plan."""

    SOLVED = 0
    NOT_SOLVED = 1
    """The solver failed: the plan continues the one before."""
    REFUSED = 2
    """The control loop cannot follow it (not finite, not in order, out of limits, old): it follows the one before."""


def _time(about: str) -> Column:
    return Column(
        "t_ns", "<i8", unit="s", about=f"{about}, since start_time", dataset="time", finite=True, limits=SECONDS
    )


def _protocol_time() -> Column:
    about = "position in the protocol; constant while the run waits for the operator"
    return Column("protocol_s", unit="s", about=about, dataset="protocol_time", limits=SECONDS)


def _mm(metres: Values) -> Values:
    return metres * MM_PER_M


def _bar(pascals: Values) -> Values:
    return pascals / PA_PER_BAR


def _us(nanoseconds: Values) -> Values:
    return nanoseconds / 1e3


def _deviation(covariance: Values) -> Values:
    """Return the square roots of the diagonals of covariances (n, p, p)."""
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))


def _error_mm(rows: NDArray[np.void]) -> Values:
    return np.asarray(np.linalg.norm(rows["measured_m"] * MM_PER_M - rows["model_m"] * MM_PER_M, axis=1))


def _reference_error_mm(rows: NDArray[np.void]) -> Values:
    off = (rows["measured_m"] - rows["reference_m"]) * MM_PER_M
    known = np.isfinite(rows["reference_m"]).any(axis=1) & np.isfinite(rows["measured_m"]).all(axis=1)
    return np.where(known, np.sqrt(np.nansum(off**2, axis=1)), np.nan)


_STATUSES = ", ".join(f"{s.value} {s.name.lower()}" for s in DetectionStatus)


class Pressure(Table):
    """Control cycles: (n,), per actuator (n, N), per valve (n, V). Gauge pressures."""

    group, rows, signal, about = "pressure", "N", "measured_bar", "one row per control cycle"

    time_s = _time("time of the newest scan of the cycle")
    tick = Column("tick", "<i8", about="number of the control cycle")
    protocol_s = _protocol_time()
    setpoint_bar = Column("setpoint_pa", axes=("actuator",), unit="bar", about="set-point", convert=_bar)
    measured_bar = Column(
        "measured_pa", axes=("actuator",), unit="bar", about="mean of the scans since the last cycle", convert=_bar
    )
    valve_v = Column(
        "valve_v",
        axes=("valve",),
        unit="V",
        about="voltage commanded next, if the valve takes one",
        dataset="valve_V",
    )
    scans = Column("scans", "<i4", about="number of scans in the mean")


class Auxiliary(Table):
    """Auxiliary inputs (n, I) at the control cycles, each in its own unit."""

    group, rows, signal = "aux", "N", "value"
    about = "auxiliary inputs of the rig file, one row per control cycle"

    time_s = _time("time of the newest scan of the cycle")
    value = Column(
        "aux", axes=("input",), about="mean of the scans since the last value; NaN outside the span of the sensor"
    )

    def __init__(self, values: Mapping[str, Values], inputs: Iterable[str], units: Iterable[str]) -> None:
        super().__init__(values)
        self.inputs = tuple(inputs)
        self.units = tuple(units)


class Timing(Table):
    """Timing of the control cycles (n,), and losses of the whole run."""

    group, rows, signal = "timing", "N", "lateness_us"

    time_s = _time("time of the newest scan of the cycle")
    overruns = Column("missed", "<i4", about="deadlines missed since the last cycle")
    lateness_us = Column("lateness_ns", "<i8", unit="us", about="how late the control cycle began", convert=_us)

    def __init__(
        self, values: Mapping[str, Values], dropped_frames: int, ring_overflows: int, counters: Mapping[str, int]
    ) -> None:
        super().__init__(values)
        self.dropped_frames = dropped_frames
        self.ring_overflows = ring_overflows
        self.counters = dict(counters)


class Tip(Table):
    """Camera frames (m,): tool centre points (m, 3) in the rod-base frame; NaN without a measurement."""

    group, rows, signal = "tip", "M", "error_mm"
    about = "one row per camera frame; NaN where nothing was measured"

    time_s = _time("middle of the exposure")
    frame = Column("frame", "<i8", about="number of the camera's frame")
    protocol_s = _protocol_time()
    seen = Column("seen", "<i4", about=_STATUSES, among=tuple(DetectionStatus))
    model_ok = Column(
        "model_ok", "<i4", about="0 where the model could not solve the step", read=lambda stored: stored.astype(bool)
    )
    pressure_bar = Column("pressure_pa", axes=("actuator",), unit="bar", about="input of the model", convert=_bar)
    weight_g = Column(
        "weight_kg",
        unit="g",
        about="weight on the end cap; zero if force_N is measured",
        convert=lambda kg: kg * 1e3,
        missing=0,
    )
    force_n = Column(
        "force_n",
        axes=("axis",),
        unit="N",
        about="measured force on the arm at the measured point, rod-base axes; zero where none was measured",
        dataset="force_N",
        missing=0,
    )
    moment_n_m = Column(
        "moment_n_m",
        axes=("axis",),
        unit="N.m",
        about="of the same wrench, about the measured point",
        dataset="moment_Nm",
        missing=0,
    )
    measured_mm = Column(
        "measured_m", axes=("axis",), unit="mm", about="tool centre point measured by the camera", convert=_mm
    )
    uncertainty_mm = Column(
        of=lambda rows: _deviation(rows["covariance_m2"]) * MM_PER_M,
        axes=("axis",),
        unit="mm",
        about="standard uncertainty of measured_mm, per axis",
    )
    covariance_mm2 = Column(
        "covariance_m2",
        axes=("component",),
        shape=("axis", "axis"),
        unit="mm^2",
        about="covariance of measured_mm: xx, xy, xz, yy, yz, zz",
        convert=lambda covariance: covariance[:, _UPPER[0], _UPPER[1]] * MM_PER_M**2,
        read=lambda stored: stored[:, _FULL],
    )
    model_mm = Column(
        "model_m",
        axes=("axis",),
        unit="mm",
        about="tool centre point of the model; where `model_ok` is 0, the last solved one",
        convert=_mm,
    )
    error_mm = Column(of=_error_mm, unit="mm", about="distance between measured and model tip")
    reprojection_px = Column("reprojection_px", unit="px", about="rms over the board's corners")
    age_us = Column("age_ns", "<i8", unit="us", about="from exposure to result", convert=_us)
    dropped = Column("dropped", "<i4", about="frames lost before this frame", limits=COUNT)
    camera_seen = Column(
        "camera_seen",
        "<i4",
        axes=("camera",),
        about="detection status of each camera, as `seen`; the tip uses the cameras with 0",
        among=tuple(DetectionStatus),
    )
    camera_skew_us = Column(
        "camera_skew_s",
        axes=("camera",),
        unit="us",
        about="exposure relative to time; NaN where a camera gave no picture",
        convert=lambda seconds: seconds * 1e6,
    )


class Backbone(Table):
    """The model's centre line (m, points, 3) from base to tip, at the times of `Tip`; NaN without a solution."""

    group, rows, signal = "backbone", "M", "model_mm"
    about = "one row per camera frame; NaN where the model could not solve the step"

    time_s = _time("middle of the exposure")
    model_mm = Column(
        "backbone_m",
        "<f4",
        axes=("station", "axis"),
        unit="mm",
        about="centre line of the model from the base to the tip; NaN where the step was not solved",
        convert=_mm,
    )


class Simulated(Table):
    """The simulator's own tool centre point (m, 3), at the times of `Tip`."""

    group, rows, signal = "simulator", "M", "tip_mm"
    about = "SIMULATED truth; measurements are in /entry/tip"

    time_s = _time("middle of the exposure")
    tip_mm = Column(
        "truth_m", axes=("axis",), unit="mm", about="SIMULATED: true tool centre point of the simulator", convert=_mm
    )


class Reference(Table):
    """Where the tip has to be (m, 3), at the times of `Tip`; NaN outside tip paths and in free coordinates."""

    group, rows, signal = "reference", "M", "error_mm"
    about = "one row per camera frame; NaN outside tip paths, and in coordinates that are not controlled"

    time_s = _time("middle of the exposure")
    reference_mm = Column(
        "reference_m", axes=("axis",), unit="mm", about="reference of the tool centre point", convert=_mm
    )
    predicted_mm = Column(
        "predicted_m",
        axes=("axis",),
        unit="mm",
        about="tool centre point of the model under the feed-forward set-points, computed before the run",
        convert=_mm,
    )
    motion = Column("tip_motion", "<i4", about="number of the protocol's tip path, from 1; 0 outside")
    period = Column(
        "tip_period",
        "<i4",
        about="number of the path's period, from 1; 0 outside and in the lead-in; 1 without periods",
    )
    error_mm = Column(
        of=_reference_error_mm, unit="mm", about="distance between measured tip and reference, controlled coordinates"
    )


class Learning(Table):
    """What a run was given of earlier runs (m, 3), at the times of `Tip`. Only for runs that learn."""

    group, rows, signal = "learning", "M", "disturbance_mm"
    about = "iterative learning: what earlier runs have shown of the arm beyond the controller's model"

    time_s = _time("middle of the exposure")
    disturbance_mm = Column(
        "learned_m",
        axes=("axis",),
        unit="mm",
        about="learned difference between the tip and that of the controller's model; NaN outside tip paths",
        convert=_mm,
    )

    def __init__(self, values: Mapping[str, Values], learned_from: Iterable[str]) -> None:
        super().__init__(values)
        self.learned_from = tuple(learned_from)


class Adaptation(Table):
    """Online estimates of P parameters, each in its own unit, per frame (m,)."""

    group, rows, signal = "adaptation", "M", "value"
    about = "parameters estimated during the run; never used for control"

    time_s = _time("middle of the exposure")
    frame = Column("frame", "<i8", about="as in /entry/tip")
    used = Column(
        "used",
        "<i4",
        about="1; 0 where the frame gave no information (no tip, or no equilibrium); 2 where it was an outlier and "
        "counted less",
    )
    start_model_mm = Column(
        "start_model_m", axes=("axis",), unit="mm", about="the tip with the initial values", convert=_mm
    )
    value = Column("value", axes=("parameter",), about="estimate after the frame")
    uncertainty = Column(
        of=lambda rows: _deviation(rows["covariance"]), axes=("parameter",), about="one standard deviation of value"
    )
    covariance = Column("covariance", axes=("parameter", "parameter"), about="covariance of value")

    def __init__(
        self,
        values: Mapping[str, Values],
        parameter: Iterable[str],
        unit: Iterable[str],
        start: Values,
        start_uncertainty: Values,
    ) -> None:
        super().__init__(values)
        self.parameter = tuple(parameter)
        self.unit = tuple(unit)
        self.start = start
        self.start_uncertainty = start_uncertainty


class TipControl(Table):
    """What the tip controller found from each frame (m,), and its plan. Only for runs with a tip controller."""

    group, rows, signal = "tip_control", "M", "predicted_mm"
    about = "one row per plan of the tip controller"

    time_s = _time("middle of the exposure of the frame that led to the plan")
    frame = Column("frame", "<i8", about="as in /entry/tip")
    start_s = Column("start_s", unit="s", about="protocol time from which the plan is followed", limits=SECONDS)
    late_ms = Column(
        "late_s",
        unit="ms",
        about="from start_s to when the control loop took the plan; 0 in virtual time",
        convert=lambda s: s * 1e3,
    )
    status = Column(
        "status",
        "<i4",
        about=f"{', '.join(f'{s.value} {s.name.lower()}' for s in SolveStatus)}",
        among=tuple(SolveStatus),
    )
    iterations = Column("iterations", "<i4", about="iterations of the solver", limits=COUNT)
    active = Column("active", "<i4", about="active constraints of the solver", limits=COUNT)
    solve_us = Column(
        "solve_ns",
        "<i8",
        unit="us",
        about="time of the step; 0 in virtual time, which repeats bit for bit",
        convert=_us,
    )
    plan_bar = Column(
        "plan_pa",
        axes=("ahead", "valve"),
        unit="bar",
        about="set-points of the plan at these times after its start; NaN beyond its end",
        convert=_bar,
    )
    predicted_mm = Column(
        "predicted_m",
        axes=("axis",),
        unit="mm",
        about="tip that the controller expects at the start of the plan; NaN without a prediction",
        convert=_mm,
    )
    payload_g = Column(
        "payload_kg", unit="g", about="estimated payload beyond the cap of the rig file", convert=lambda kg: kg * 1e3
    )
    payload_std_g = Column(
        "payload_std_kg", unit="g", about="one standard deviation of payload_g", convert=lambda kg: kg * 1e3
    )
    nis = Column("nis", about="normalised innovation squared of the frame; 3 on average if the estimator is consistent")


PLAN_AHEAD_S = (0.0, 0.1, 0.2, 0.3)
"""Times after the start of a plan at which its set-points are recorded."""

AXES = {
    "ahead": (str(len(PLAN_AHEAD_S)), "time [s] after the start of the plan"),
    "axis": ("3", "x, y, z of the rod-base frame"),
    "component": ("6", "names of the covariance's columns"),
    "actuator": ("A", "1, 2, .."),
    "valve": ("V", "1, 2, .."),
    "input": ("I", "names of the auxiliary inputs in the rig file"),
    "camera": ("C", "names of the cameras in the rig file"),
    "station": ("L", "0 to 1, share of the length of the arm at rest"),
    "parameter": ("P", "its name, as in `rig identify --free`"),
}
"""Size of each axis in the reference page, and what its scale holds."""

SAMPLES: tuple[type[Table], ...] = (Pressure, Timing)
AUXILIARY: tuple[type[Table], ...] = (Auxiliary,)
OBSERVATIONS: tuple[type[Table], ...] = (Tip, Backbone, Simulated, Reference, Learning)
ADAPTATIONS: tuple[type[Table], ...] = (Adaptation,)
TIP_CONTROL: tuple[type[Table], ...] = (TipControl,)
"""The tables of each record."""
