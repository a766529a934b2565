"""Columns of the measured sections: cross-sections of the arm that carry boards of their own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from runs.columns.conversions import MM_PER_M, time_column, to_mm
from runs.columns.declaration import Column, Table, Values
from runs.columns.observations import STATUSES, DetectionStatus, full_matrix, upper_triangle

_DEG2_PER_RAD2 = (180 / np.pi) ** 2


def _error_mm(rows: NDArray[np.void]) -> Values:
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
        convert=lambda covariance: upper_triangle(covariance) * _DEG2_PER_RAD2,
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
    error_mm = Column(of=_error_mm, axes=("section",), unit="mm", about="distance between measured and modelled point")
