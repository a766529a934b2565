"""Creep: the push of a constant pressure grows with time."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from rig.arm_effects.base import ArmEffect, ArmEffectSection
from rig.sections.base import Section


class CreepBranch(Section):
    """One retardation branch: a constant pressure gains `amount` with the time constant `time_s`."""

    amount: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False, strict=True)]
    time_s: Annotated[float, Field(ge=1e-3, le=1e6, allow_inf_nan=False, strict=True)]


class CreepSection(ArmEffectSection):
    """A generalised Kelvin chain between the pressure and the push."""

    type: Literal["creep"]
    branches: Annotated[tuple[CreepBranch, ...], Field(min_length=1, max_length=8)]

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        return CreepEffect(actuators, step_s, [(branch.amount, branch.time_s) for branch in self.branches])


class CreepEffect(ArmEffect):
    """P + sum_k g_k y_k with T_k dy_k/dt = P - y_k: exact for a pressure that is constant over a step."""

    def __init__(self, actuators: int, step_s: float, branches: list[tuple[float, float]]) -> None:
        self._branches = [
            (amount, -math.expm1(-step_s / time_s), [0.0] * actuators) for amount, time_s in branches if amount
        ]

    def advance(self, pressure_bar: list[float]) -> list[float]:
        """Relax each branch towards the pressure; add its share."""
        out = list(pressure_bar)
        for amount, gain, strain in self._branches:
            for i, pressure in enumerate(pressure_bar):
                strain[i] += gain * (pressure - strain[i])
                out[i] += amount * strain[i]
        return out
