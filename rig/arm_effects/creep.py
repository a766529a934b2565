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
        """P + sum_k g_k y_k with T_k dy_k/dt = P - y_k: exact for a pressure that is constant over a step."""
        branches = [(b.amount, -math.expm1(-step_s / b.time_s), [0.0] * actuators) for b in self.branches if b.amount]

        def advance(pressure_bar: list[float]) -> list[float]:
            out = list(pressure_bar)
            for amount, gain, strain in branches:
                for i, pressure in enumerate(pressure_bar):
                    strain[i] += gain * (pressure - strain[i])
                    out[i] += amount * strain[i]
            return out

        return advance
