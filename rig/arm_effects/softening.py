"""Mullins softening: an actuator yields more after its first cycles."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from rig.arm_effects.base import ArmEffect, ArmEffectSection

Amount = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False, strict=True)]
Scale = Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False, strict=True)]


class SofteningSection(ArmEffectSection):
    """Damage by the highest pressure so far and by the pressure travelled, as in Miehe (1995)."""

    type: Literal["softening"]
    by_peak: Amount
    peak_bar: Scale
    by_cycles: Amount
    travel_bar: Scale

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """An arm that has never been pressed; the step does not matter."""
        return SofteningEffect(actuators, self)


class SofteningEffect(ArmEffect):
    """P (1 + a (1 - exp(-max P / p)) + b (1 - exp(-integral |dP| / q))) with the maximum and travel so far."""

    def __init__(self, actuators: int, section: SofteningSection) -> None:
        self._section = section
        self._before, self._peak, self._travel = [0.0] * actuators, [0.0] * actuators, [0.0] * actuators

    def advance(self, pressure_bar: list[float]) -> list[float]:
        """Add to the damage; multiply the push by the loss of stiffness."""
        section, out = self._section, []
        for i, pressure in enumerate(pressure_bar):
            self._travel[i] += abs(pressure - self._before[i])
            self._peak[i] = max(pressure, self._peak[i])
            damage = -section.by_peak * math.expm1(-self._peak[i] / section.peak_bar)
            damage -= section.by_cycles * math.expm1(-self._travel[i] / section.travel_bar)
            out.append(pressure * (1.0 + damage))
        self._before = list(pressure_bar)
        return out
