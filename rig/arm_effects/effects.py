"""What the simulated arm does and the model does not assume: one class per effect, registered in `registry`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from protocols.validation import ValidationFault
from rig.arm_effects.base import ArmEffect, ArmEffectSection
from rig.sections.base import Section

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False, strict=True)]
Gain = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False, strict=True)]
Scale = Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False, strict=True)]


class GainsSection(ArmEffectSection):
    """Actuators of unequal strength: a factor on the push of each."""

    type: Literal["gains"]
    gains: tuple[Gain, ...]

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """g_i P_i."""
        return lambda pressure_bar: [gain * p for gain, p in zip(self.gains, pressure_bar, strict=True)]

    def actuator_faults(self, actuators: int) -> Iterator[ValidationFault]:
        if len(self.gains) != actuators:
            yield ValidationFault(("gains",), f"{actuators} of them, one for each actuator")


class CouplingSection(ArmEffectSection):
    """A pressed chamber pushes on the walls of the others: a share of their pressures acts in each."""

    type: Literal["coupling"]
    share: Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False, strict=True)]

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """P_i + c sum_{j != i} P_j."""

        def advance(pressure_bar: list[float]) -> list[float]:
            common = self.share * sum(pressure_bar)
            return [common + (1.0 - self.share) * pressure for pressure in pressure_bar]

        return advance


class PushSection(ArmEffectSection):
    """The bore widens: P (1 + k P), with the pressure of the actuator itself or the sum of all."""

    type: Literal["push"]
    per_bar: Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False, strict=True)]
    pressure: Literal["own", "sum"] = "own"

    def effect(self, actuators: int, step_s: float) -> ArmEffect:
        """P_i (1 + k P_i), or P_i (1 + k sum_j P_j)."""
        per_bar = self.per_bar
        if self.pressure == "own":
            return lambda pressure_bar: [p * (1.0 + per_bar * p) for p in pressure_bar]
        return lambda pressure_bar: [p * (1.0 + per_bar * sum(pressure_bar)) for p in pressure_bar]


class SofteningSection(ArmEffectSection):
    """Mullins softening by the highest pressure so far and by the pressure travelled, as in Miehe (1995)."""

    type: Literal["softening"]
    by_peak: Share
    peak_bar: Scale
    by_cycles: Share
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


class SlipElement(Section):
    """A spring of relative stiffness `weight` in series with a slider that slips at `slip_bar`."""

    weight: Share
    slip_bar: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False, strict=True)]


class HysteresisSection(ArmEffectSection):
    """Friction of the braid: Prandtl-Ishlinskii operator of stop elements (Maxwell slip), one for each actuator."""

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


class CreepBranch(Section):
    """One retardation branch: a constant pressure gains `amount` with the time constant `time_s`."""

    amount: Share
    time_s: Annotated[float, Field(ge=1e-3, le=1e6, allow_inf_nan=False, strict=True)]


class CreepSection(ArmEffectSection):
    """The push of a constant pressure grows: a generalised Kelvin chain between the pressure and the push."""

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
