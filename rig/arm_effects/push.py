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
        return OwnPressurePushEffect(self.per_bar) if self.pressure == "own" else SumPressurePushEffect(self.per_bar)


class OwnPressurePushEffect(ArmEffect):
    """P_i (1 + k P_i)."""

    def __init__(self, per_bar: float) -> None:
        self._per_bar = per_bar

    def advance(self, pressure_bar: list[float]) -> list[float]:
        return [pressure * (1.0 + self._per_bar * pressure) for pressure in pressure_bar]


class SumPressurePushEffect(ArmEffect):
    """P_i (1 + k sum_j P_j)."""

    def __init__(self, per_bar: float) -> None:
        self._per_bar = per_bar

    def advance(self, pressure_bar: list[float]) -> list[float]:
        """Scale all pressures by their sum."""
        scale = 1.0 + self._per_bar * sum(pressure_bar)
        return [pressure * scale for pressure in pressure_bar]
