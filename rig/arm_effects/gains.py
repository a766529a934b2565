"""Actuators of unequal strength."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from protocols.validation import ValidationFault
from rig.arm_effects.base import ArmEffect, ArmEffectSection

Gain = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False, strict=True)]


class GainsSection(ArmEffectSection):
    """A factor on the push of each actuator."""

    type: Literal["gains"]
    gains: tuple[Gain, ...]

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """g_i P_i."""
        return lambda pressure_bar: [gain * p for gain, p in zip(self.gains, pressure_bar, strict=True)]

    def actuator_faults(self, actuators: int) -> Iterator[ValidationFault]:
        if len(self.gains) != actuators:
            yield ValidationFault(("gains",), f"{actuators} of them, one for each actuator")
