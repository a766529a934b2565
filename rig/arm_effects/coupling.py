"""Coupling of the chambers: a pressed chamber pushes on the walls of the others."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from rig.arm_effects.base import ArmEffect, ArmEffectSection


class CouplingSection(ArmEffectSection):
    """A share of the pressures of all other chambers acts in each."""

    type: Literal["coupling"]
    share: Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False, strict=True)]

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """P_i + c sum_{j != i} P_j."""

        def advance(pressure_bar: list[float]) -> list[float]:
            common = self.share * sum(pressure_bar)
            return [common + (1.0 - self.share) * pressure for pressure in pressure_bar]

        return advance
