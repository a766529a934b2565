"""A push that grows more than in proportion to the pressure: the bore widens."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from rig.arm_effects.base import ArmEffect, ArmEffectSection


class PushSection(ArmEffectSection):
    """P (1 + k P), with the pressure of the actuator itself or the sum of all."""

    type: Literal["push"]
    per_bar: Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False, strict=True)]
    pressure: Literal["own", "sum"] = "own"

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """P_i (1 + k P_i), or P_i (1 + k sum_j P_j)."""
        per_bar = self.per_bar
        if self.pressure == "own":
            return lambda pressure_bar: [p * (1.0 + per_bar * p) for p in pressure_bar]
        return lambda pressure_bar: [p * (1.0 + per_bar * sum(pressure_bar)) for p in pressure_bar]
