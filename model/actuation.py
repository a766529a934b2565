"""Actuation laws: the force with which the gas in the chambers pushes on the ends of the arm.

A chamber of area A_in under the gauge pressure P_i pushes with A_in p_i. The push pressure p_i is the pressure itself,
or grows with the pressures, as in a braid or wall that widens under them. The radial pressure effect is not part of it.
With friction, law and radial effect take the effective pressures of model/hysteresis.py.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from numpy.typing import NDArray

from model.units import PA_PER_BAR

MOST_STOPS = 3
"""Stop elements of an actuator."""


@dataclass(frozen=True)
class StopElement:
    """A spring in series with a slider. weight: its share of the pressure; width_pa: at which the slider slips."""

    weight: float
    width_pa: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.weight) and 0 <= self.weight <= 1):
            raise ValueError(f"the weight of a stop element must lie in [0, 1], got {self.weight}")
        if not (math.isfinite(self.width_pa) and self.width_pa > 0):
            raise ValueError(f"width_pa of a stop element must be positive and finite, got {self.width_pa}")


@dataclass(frozen=True)
class ActuationLaw(ABC):
    """A law of the push pressures, and the friction of the actuators.

    growth_per_bar: relative growth of the push, k [1/bar]; zero for a law without growth. stops: elements of the
    Prandtl-Ishlinskii operator of every actuator; none for no hysteresis. Static solutions have no hysteresis. Raises
    ValueError for a growth that is not finite or not of this law, and for too many stops.
    """

    growth_per_bar: float = 0.0
    stops: tuple[StopElement, ...] = ()

    name: ClassVar[str]
    grows: ClassVar[bool] = True
    """Whether the push depends on growth_per_bar."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.growth_per_bar):
            raise ValueError(f"growth_per_bar must be finite, got {self.growth_per_bar}")
        object.__setattr__(self, "stops", tuple(self.stops))
        if len(self.stops) > MOST_STOPS:
            raise ValueError(f"an actuator has at most {MOST_STOPS} stop elements, got {len(self.stops)}")
        if self.growth_per_bar and not self.grows:
            raise ValueError(f"a {self.name} push does not grow: growth_per_bar must be 0, got {self.growth_per_bar}")

    @abstractmethod
    def push_pa(self, pressure_pa: NDArray[Any]) -> NDArray[Any]:
        """Push pressures (.., N) [Pa] under gauge pressures (.., N) [Pa]."""


class Proportional(ActuationLaw):
    """p_i = P_i: chambers of constant area."""

    name = "proportional"
    grows = False

    def push_pa(self, pressure_pa: NDArray[Any]) -> NDArray[Any]:
        """The pressures themselves."""
        return pressure_pa


class OwnPressure(ActuationLaw):
    """p_i = P_i (1 + k P_i): each chamber widens under its own pressure."""

    name = "own-pressure"

    def push_pa(self, pressure_pa: NDArray[Any]) -> NDArray[Any]:
        """Push pressures by the pressure of each chamber."""
        return pressure_pa * (1 + self.growth_per_bar / PA_PER_BAR * pressure_pa)


class PressureSum(ActuationLaw):
    """p_i = P_i (1 + k sum_j P_j): the chambers widen together."""

    name = "pressure-sum"

    def push_pa(self, pressure_pa: NDArray[Any]) -> NDArray[Any]:
        """Push pressures by the sum of the pressures of all chambers."""
        total: NDArray[Any] = pressure_pa.sum(axis=-1, keepdims=True)
        return pressure_pa * (1 + self.growth_per_bar / PA_PER_BAR * total)


ACTUATION_LAWS: dict[str, type[ActuationLaw]] = {law.name: law for law in (Proportional, OwnPressure, PressureSum)}


def actuation_law_named(name: str) -> type[ActuationLaw]:
    """The actuation law of a name; ValueError for an unknown one."""
    if name not in ACTUATION_LAWS:
        raise ValueError(f"unknown actuation law {name!r}: {', '.join(ACTUATION_LAWS)}")
    return ACTUATION_LAWS[name]
