"""Columns and conversions that several tables share."""

from __future__ import annotations

import numpy as np

from runs.columns.declaration import Column, Values

PA_PER_BAR = 1e5
MM_PER_M = 1e3


def time_column(about: str) -> Column:
    """Time of a row [s]."""
    return Column("t_ns", "<i8", unit="s", about=f"{about}, since start_time", dataset="time")


def protocol_time_column() -> Column:
    """Position in the protocol [s]."""
    about = "position in the protocol; constant while the run waits for the operator"
    return Column("protocol_s", unit="s", about=about, dataset="protocol_time")


def to_mm(metres: Values) -> Values:
    """Metres in millimetres."""
    return metres * MM_PER_M


def to_bar(pascals: Values) -> Values:
    """Pascals in bar."""
    return pascals / PA_PER_BAR


def to_us(nanoseconds: Values) -> Values:
    """Nanoseconds in microseconds."""
    return nanoseconds / 1e3


def from_mm(millimetres: Values) -> Values:
    """Millimetres in metres."""
    return millimetres / MM_PER_M


def from_bar(bars: Values) -> Values:
    """Bar in pascals."""
    return bars * PA_PER_BAR


def from_us(microseconds: Values) -> Values:
    """Microseconds in nanoseconds."""
    return microseconds * 1e3


def deviation(covariance: Values) -> Values:
    """Standard deviations (n, p) of covariances (n, p, p)."""
    return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
