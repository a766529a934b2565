"""Columns of the online estimation."""

from __future__ import annotations

from runs.columns.conversions import deviation, time_column, to_mm
from runs.columns.declaration import Column, Table, Values


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
