"""The interface of an effect: a section of the rig file, and the function that advances it with the plant's time.

An effect turns the pressures of the chambers into the pressures that an ideal arm would need for the same push. The
registry is part of the rig file's schema, so these modules must not import the compiler.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from protocols.validation import ValidationFault
from rig.sections.base import Section

ArmEffect = Callable[[list[float]], list[float]]
"""Advance by one step at the pressures (N,) [bar, gauge] of its end; return the effective pressures (N,)."""


class ArmEffectSection(Section, ABC):
    """An entry of `simulator: arm_effects:`. A subclass declares `type` as a Literal of its name."""

    type: str

    @abstractmethod
    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """An effect on a rested arm with `actuators`, without pressure, which advances in steps of `step_s`."""

    def actuator_faults(self, actuators: int) -> Iterator[ValidationFault]:
        """Problems of the section for an arm with `actuators`."""
        yield from ()
