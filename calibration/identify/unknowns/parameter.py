"""A parameter of an identification: one number of a setup that can be free, and its prior."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from calibration.identify.unknowns.setup import Setup

Read = Callable[[Setup], float]
Write = Callable[[Setup, float], Setup]

# Standard uncertainties of mountings that were not measured.
MOUNTING_M, MOUNTING_RAD = 2e-3, 0.03


@dataclass(frozen=True)
class Parameter:
    """One number that can be free.

    span: plausible distance from its start, the standard deviation of a prior where nothing is stated. lower, upper:
    bounds; below: an upper bound by another number of a setup. per_run: each run has its own value, as a sensor offset.
    absent_at_zero: at zero the arm does not have what the number describes. uncertainty: standard uncertainty of a
    stated value, by the kind of the number, where none is stated with it.
    """

    name: str
    unit: str
    about: str
    read: Read
    write: Write
    span: Callable[[float], float]
    uncertainty: Callable[[float], float]
    lower: float
    upper: float
    per_run: bool = False
    absent_at_zero: bool = False
    below: Callable[[Setup], float] = lambda _: math.inf


@dataclass(frozen=True)
class Prior:
    """Normal prior distribution of a parameter."""

    mean: float
    std: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mean) and math.isfinite(self.std) and self.std > 0):
            raise ValueError(f"a prior needs a finite mean and a positive deviation, got {self.mean} and {self.std}")


def constant(value: float) -> Callable[[float], float]:
    """The same for every value of the parameter."""
    return lambda _: value
