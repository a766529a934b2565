"""Rate-independent hysteresis of each actuator: friction between braid and wall."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from rig.arm_effects.base import ArmEffect, ArmEffectSection
from rig.sections.base import Section


class SlipElement(Section):
    """A spring of relative stiffness `weight` in series with a slider that slips at `slip_bar`."""

    weight: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False, strict=True)]
    slip_bar: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False, strict=True)]


class HysteresisSection(ArmEffectSection):
    """Prandtl-Ishlinskii operator of stop elements (Maxwell-slip model), one for each actuator."""

    type: Literal["hysteresis"]
    elements: Annotated[tuple[SlipElement, ...], Field(min_length=1, max_length=16)]

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """P - sum_k w_k s_k, where the stop s_k follows P within -r_k and r_k, at any rate."""
        elements = [(e.weight, e.slip_bar, [0.0] * actuators) for e in self.elements if e.weight]
        before = [0.0] * actuators

        def advance(pressure_bar: list[float]) -> list[float]:
            out = list(pressure_bar)
            for i, pressure in enumerate(pressure_bar):
                change = pressure - before[i]
                for weight, slip, stop in elements:
                    force = stop[i] + change
                    stop[i] = force = slip if force > slip else -slip if force < -slip else force
                    out[i] -= weight * force
            before[:] = pressure_bar
            return out

        return advance
