"""A parameter of an identification: one number of a setup that can be free, and its prior."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from calibration.identify.setup import Setup

Read = Callable[[Setup], float]
Write = Callable[[Setup, float], Setup]

# Standard uncertainties of mountings that were not measured.
MOUNTING_M, MOUNTING_RAD = 2e-3, 0.03


@dataclass(frozen=True)
class Parameter:
    """One number that can be free.

    span: plausible distance from its start; a parameter with a larger uncertainty is not identified. lower, upper:
    bounds; below: an upper bound by another number of a setup. per_run: each run has its own value, as a sensor offset.
    reciprocal: the data are linear in its reciprocal, as in a compliance instead of a stiffness; it is positive.
    decades: range of random starting points in powers of ten. uncertainty: standard uncertainty of a stated value, by
    the kind of the number, where none is stated with it.
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
    reciprocal: bool = False
    decades: float = 0.0
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
