"""Columns of the camera frames: what was measured in each, and what model and simulator say beside it."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from runs.columns.conversions import MM_PER_M, deviation, protocol_time_column, time_column, to_bar, to_mm, to_us
from runs.columns.declaration import Column, Table, Values

BACKBONE_POINTS = 11
"""Points of the model's backbone, evenly spaced along the arm at rest."""
DATAGRAM_COUNTS = ("lost", "doubled", "reordered", "late", "malformed", "foreign", "implausible", "clock_steps")
"""What is counted of a tracker's messages: those that were not used, by reason, and steps of the sender's clock."""
_DEG_PER_RAD = 180 / np.pi
_UPPER = (np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2]))
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class DetectionStatus(IntEnum):
    """Result of the tip measurement in a frame; NO_POSE and NO_MESSAGE are those of a tracker."""

    MEASURED = 0
    NO_BOARD = 1
    AMBIGUOUS = 2
    POOR_FIT = 3
    NO_FRAME = 4
    DISAGREE = 5
    NO_CAMERA = 6
    NO_POSE = 7
    NO_MESSAGE = 8

    @property
    def words(self) -> str:
        """The result in words."""
        return self.name.lower().replace("_", " ")


def upper_triangle(covariance: Values) -> Values:
    """Upper triangles (.., 6) of covariances (.., 3, 3)."""
    return covariance[..., _UPPER[0], _UPPER[1]]


def full_matrix(stored: Values) -> Values:
    """Covariances (.., 3, 3) of upper triangles (.., 6)."""
    return stored[..., _FULL]


def model_error_mm(rows: NDArray[np.void]) -> Values:
    """Distance (n,) of the measured tip from the model's in rows (n,); NaN where none was measured."""
    return np.asarray(np.linalg.norm(rows["measured_m"] * MM_PER_M - rows["model_m"] * MM_PER_M, axis=1))


STATUSES = ", ".join(f"{s.value} {s.name.lower()}" for s in DetectionStatus)


class Tip(Table):
    """Camera frames (m,): tool centre points (m, 3) in the rod-base frame; NaN without a measurement."""

    group, rows, signal = "tip", "M", "error_mm"
    about = "one row per camera frame; NaN where nothing was measured"

    time_s = time_column("middle of the exposure; of a tracker: time of the pose")
    frame = Column("frame", "<i8", about="number of the camera's frame")
    protocol_s = protocol_time_column()
    seen = Column("seen", "<i4", about=STATUSES, among=tuple(DetectionStatus))
    model_ok = Column(
        "model_ok", "<i4", about="0 where the model could not solve the step", read=lambda stored: stored.astype(bool)
    )
    pressure_bar = Column("pressure_pa", axes=("actuator",), unit="bar", about="input of the model", convert=to_bar)
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
        "measured_m", axes=("axis",), unit="mm", about="tool centre point measured by camera or tracker", convert=to_mm
    )
    uncertainty_mm = Column(
        of=lambda rows: deviation(rows["covariance_m2"]) * MM_PER_M,
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
        convert=lambda covariance: upper_triangle(covariance) * MM_PER_M**2,
        read=full_matrix,
    )
    orientation_deg = Column(
        "orientation_rad",
        axes=("axis",),
        unit="deg",
        about="measured rotation vector of the tip frame in the rod-base frame",
        convert=np.rad2deg,
    )
    orientation_uncertainty_deg = Column(
        of=lambda rows: np.rad2deg(deviation(rows["orientation_covariance_rad2"])),
        axes=("axis",),
        unit="deg",
        about="standard uncertainty of a small rotation of the tip about each axis",
    )
    orientation_covariance_deg2 = Column(
        "orientation_covariance_rad2",
        axes=("component",),
        shape=("axis", "axis"),
        unit="deg^2",
        about="covariance of that small rotation about the rod-base axes: xx, xy, xz, yy, yz, zz",
        convert=lambda covariance: upper_triangle(covariance) * _DEG_PER_RAD**2,
        read=full_matrix,
    )
    cross_covariance_mm_deg = Column(
        "cross_covariance_m_rad",
        axes=("axis", "turn"),
        unit="mm.deg",
        about="covariance of measured_mm (rows) with that small rotation (columns)",
        convert=lambda covariance: covariance * MM_PER_M * _DEG_PER_RAD,
    )
    model_mm = Column(
        "model_m",
        axes=("axis",),
        unit="mm",
        about="tool centre point of the model; where `model_ok` is 0, the last solved one",
        convert=to_mm,
    )
    error_mm = Column(of=model_error_mm, unit="mm", about="distance between measured and model tip")
    reprojection_px = Column("reprojection_px", unit="px", about="rms over the board's corners")
    age_us = Column("age_ns", "<i8", unit="us", about="from exposure to result", convert=to_us)
    dropped = Column("dropped", "<i4", about="frames lost before this frame")
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

    @property
    def deviation_mm(self) -> Values:
        """The measured tip minus the model's (m, 3); its length is `error_mm`."""
        return np.asarray(self.measured_mm - self.model_mm)


class Backbone(Table):
    """The model's centre line (m, points, 3) from base to tip, at the times of `Tip`; NaN without a solution."""

    group, rows, signal = "backbone", "M", "model_mm"
    about = "one row per camera frame; NaN where the model could not solve the step"

    time_s = time_column("middle of the exposure")
    model_mm = Column(
        "backbone_m",
        "<f4",
        axes=("station", "axis"),
        unit="mm",
        about="centre line of the model from the base to the tip; NaN where the step was not solved",
        convert=to_mm,
    )


class Simulated(Table):
    """The simulator's own tool centre point (m, 3), at the times of `Tip`."""

    group, rows, signal = "simulator", "M", "tip_mm"
    about = "SIMULATED truth; measurements are in /entry/tip"

    time_s = time_column("middle of the exposure")
    tip_mm = Column(
        "truth_m", axes=("axis",), unit="mm", about="SIMULATED: true tool centre point of the simulator", convert=to_mm
    )


def _section_error_mm(rows: NDArray[np.void]) -> Values:
    return np.asarray(np.linalg.norm(rows["section_m"] - rows["section_model_m"], axis=2) * MM_PER_M)


class Sections(Table):
    """Measured sections (m, sections, ..) in the rod-base frame, at the times of `Tip`; NaN without a measurement."""

    group, rows, signal = "sections", "M", "error_mm"
    about = "one row per camera frame of a rig with `sections`; NaN where nothing was measured"
    facts = (("names", "section"), ("at_mm", "at_mm"))
    names: tuple[str, ...]
    at_mm: Values
    """Arc lengths from the rod base, of the arm at rest."""

    time_s = time_column("middle of the exposure")
    seen = Column("section_seen", "<i4", axes=("section",), about=STATUSES, among=tuple(DetectionStatus))
    measured_mm = Column(
        "section_m", axes=("section", "axis"), unit="mm", about="point of the arm's axis, by the board", convert=to_mm
    )
    covariance_mm2 = Column(
        "section_covariance_m2",
        axes=("section", "component"),
        shape=("section", "axis", "axis"),
        unit="mm^2",
        about="covariance of measured_mm: xx, xy, xz, yy, yz, zz",
        convert=lambda covariance: upper_triangle(covariance) * MM_PER_M**2,
        read=full_matrix,
    )
    orientation_deg = Column(
        "section_orientation_rad",
        axes=("section", "axis"),
        unit="deg",
        about="measured rotation vector of the section's frame in the rod-base frame",
        convert=np.rad2deg,
    )
    orientation_covariance_deg2 = Column(
        "section_orientation_covariance_rad2",
        axes=("section", "component"),
        shape=("section", "axis", "axis"),
        unit="deg^2",
        about="covariance of a small rotation about the rod-base axes: xx, xy, xz, yy, yz, zz",
        convert=lambda covariance: upper_triangle(covariance) * _DEG_PER_RAD**2,
        read=full_matrix,
    )
    reprojection_px = Column(
        "section_reprojection_px", axes=("section",), unit="px", about="rms over the board's corners"
    )
    model_mm = Column(
        "section_model_m",
        axes=("section", "axis"),
        unit="mm",
        about="the same point of the model; NaN where the step was not solved",
        convert=to_mm,
    )
    error_mm = Column(
        of=_section_error_mm, axes=("section",), unit="mm", about="distance between measured and modelled point"
    )


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
    foreign_sender = Column(
        "foreign_ipv4", "<i8", about="IPv4 address of the last foreign sender as one number, 0 without one", since=3
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
    )


class Adaptation(Table):
    """Online estimates of P parameters, each in its own unit, per frame (m,)."""

    group, rows, signal = "adaptation", "M", "value"
    about = "parameters estimated during the run; never used for control"
    facts = tuple((name, name) for name in ("parameter", "unit", "start", "start_uncertainty"))
    parameter: tuple[str, ...]
    unit: tuple[str, ...]
    start: Values
    start_uncertainty: Values

    time_s = time_column("middle of the exposure")
    frame = Column("frame", "<i8", about="as in /entry/tip")
    used = Column(
        "used",
        "<i4",
        about="1; 0 where the frame gave no information (no tip, or no equilibrium); 2 where it was an outlier and "
        "counted less",
    )
    start_model_mm = Column(
        "start_model_m", axes=("axis",), unit="mm", about="the tip with the initial values", convert=to_mm
    )
    value = Column("value", axes=("parameter",), about="estimate after the frame")
    uncertainty = Column(
        of=lambda rows: deviation(rows["covariance"]), axes=("parameter",), about="one standard deviation of value"
    )
    covariance = Column("covariance", axes=("parameter", "parameter"), about="covariance of value")
