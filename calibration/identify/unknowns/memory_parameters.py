"""Parameters of what an arm remembers: the Maxwell branches of its walls, the stop elements of its actuators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from model.actuation import MOST_STOPS
from model.arm import Arm
from model.material import MOST_BRANCHES

# Standard uncertainties of stated values, which no data sheet states: of shares, and of times and widths by share.
SHARE, SCALE_SHARE = 0.02, 0.5
_LEAST_SPAN = 0.05


def branch_names(number: int) -> tuple[str, str]:
    """Names of the parameters of a Maxwell branch, counted from 1."""
    return f"branch_{number}_modulus", f"branch_{number}_time_s"


def stop_names(number: int) -> tuple[str, str]:
    """Names of the parameters of a stop element, counted from 1."""
    return f"stop_{number}_weight", f"stop_{number}_width_pa"


def memory_names(arm: Arm) -> tuple[str, ...]:
    """The parameters that an arm has of these."""
    branches = [name for k in range(len(arm.material.branches)) for name in branch_names(k + 1)]
    return (*branches, *(name for k in range(len(arm.actuation.stops)) for name in stop_names(k + 1)))


ALL_NAMES = frozenset(
    name
    for count, names in ((MOST_BRANCHES, branch_names), (MOST_STOPS, stop_names))
    for k in range(count)
    for name in names(k + 1)
)


def memory_groups() -> dict[str, tuple[str, ...]]:
    """Names that stand for one number of every element."""
    moduli, times = zip(*(branch_names(k + 1) for k in range(MOST_BRANCHES)), strict=True)
    weights, widths = zip(*(stop_names(k + 1) for k in range(MOST_STOPS)), strict=True)
    return {"branch_moduli": moduli, "branch_times": times, "stop_weights": weights, "stop_widths": widths}


@dataclass(frozen=True)
class MemoryParameter:
    """One number of these: as a `Parameter`, of an arm alone. scale: it is a time or a width, not a share."""

    name: str
    unit: str
    about: str
    scale: bool
    lower: float
    upper: float
    read: Callable[[Arm], float]
    write: Callable[[Arm, float], Arm]

    def span(self, x: float) -> float:
        """A plausible distance from a value."""
        return (abs(x) or 1.0) if self.scale else max(abs(x), _LEAST_SPAN)

    def uncertainty(self, x: float) -> float:
        """Standard uncertainty of a stated value."""
        return SCALE_SHARE * self.span(x) if self.scale else SHARE


def memory_numbers() -> tuple[MemoryParameter, ...]:
    """All that an arm may have of these."""
    out = []
    for k in range(MOST_BRANCHES):
        modulus, time = branch_names(k + 1)
        out += [
            _number(modulus, "1", f"modulus of branch {k + 1} over that at rest", _BRANCHES, k, "relative_modulus"),
            _number(time, "s", f"relaxation time of branch {k + 1}", _BRANCHES, k, "time_s", 1e-3, 1e5),
        ]
    for k in range(MOST_STOPS):
        weight, width = stop_names(k + 1)
        out += [
            _number(weight, "1", f"share of the pressure that stop element {k + 1} takes", _STOPS, k, "weight"),
            _number(width, "Pa", f"pressure at which stop element {k + 1} slips", _STOPS, k, "width_pa", 10.0, 1e7),
        ]
    return tuple(out)


class _Elements:
    """Where an arm has its elements of one kind."""

    def __init__(self, get: Callable[[Arm], tuple[Any, ...]], put: Callable[[Arm, tuple[Any, ...]], Arm]) -> None:
        self._get, self._put = get, put

    def read(self, arm: Arm, k: int, attribute: str) -> float:
        """A number of element k; zero where the arm has no such element."""
        elements = self._get(arm)
        return float(getattr(elements[k], attribute)) if k < len(elements) else 0.0

    def write(self, arm: Arm, k: int, attribute: str, x: float) -> Arm:
        """The arm with another number of element k; the same where it has no such element."""
        elements = list(self._get(arm))
        if k >= len(elements):
            return arm
        elements[k] = replace(elements[k], **{attribute: x})
        return self._put(arm, tuple(elements))


_BRANCHES = _Elements(
    lambda arm: arm.material.branches,
    lambda arm, branches: arm.with_segment(material=replace(arm.material, branches=branches)),
)
_STOPS = _Elements(
    lambda arm: arm.actuation.stops, lambda arm, stops: replace(arm, actuation=replace(arm.actuation, stops=stops))
)


def _number(
    name: str,
    unit: str,
    about: str,
    elements: _Elements,
    k: int,
    attribute: str,
    lower: float = 0.0,
    upper: float = 1.0,
) -> MemoryParameter:
    return MemoryParameter(
        name, unit, about, unit != "1", lower, upper,
        lambda arm: elements.read(arm, k, attribute), lambda arm, x: elements.write(arm, k, attribute, x),
    )  # fmt: skip
