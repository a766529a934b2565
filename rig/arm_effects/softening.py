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
        """P (1 + a (1 - exp(-max P / p)) + b (1 - exp(-integral |dP| / q))) with the maximum and travel so far."""
        before, peak, travel = [0.0] * actuators, [0.0] * actuators, [0.0] * actuators

        def advance(pressure_bar: list[float]) -> list[float]:
            out = []
            for i, pressure in enumerate(pressure_bar):
                travel[i] += abs(pressure - before[i])
                peak[i] = max(pressure, peak[i])
                damage = -self.by_peak * math.expm1(-peak[i] / self.peak_bar)
                damage -= self.by_cycles * math.expm1(-travel[i] / self.travel_bar)
                out.append(pressure * (1.0 + damage))
            before[:] = pressure_bar
            return out

        return advance
