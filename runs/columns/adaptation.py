"""Columns of the online estimation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from runs.columns.conversions import deviation, time_column, to_mm
from runs.columns.declaration import Column, Table, Values


class Adaptation(Table):
    """Online estimates of P parameters, each in its own unit, per frame (m,)."""

    group, rows, signal = "adaptation", "M", "value"
    about = "parameters estimated during the run; never used for control"

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
