"""The effects that a rig file can name; one line here registers an effect."""

from __future__ import annotations

import functools
import operator
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from rig.arm_effects import effects
from rig.arm_effects.base import ArmEffectSection

ARM_EFFECTS: tuple[type[ArmEffectSection], ...] = (
    effects.CouplingSection,
    effects.CreepSection,
    effects.GainsSection,
    effects.HysteresisSection,
    effects.PushSection,
    effects.SofteningSection,
)

if TYPE_CHECKING:
    ArmEffectEntry = ArmEffectSection
else:
    ArmEffectEntry = Annotated[functools.reduce(operator.or_, ARM_EFFECTS), Field(discriminator="type")]
    """An entry of the rig file, of the registered effect that its key `type` names."""
