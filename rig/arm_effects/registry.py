"""The effects that a rig file can name; one line here registers one, another package brings one as a plug-in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.arm_effects import effects
from rig.arm_effects.base import ArmEffectSection
from rig.sections.plugins import SectionRegistry

ARM_EFFECTS = SectionRegistry[ArmEffectSection](
    "arm_effects",
    "type",
    ArmEffectSection,
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
    ArmEffectEntry = ARM_EFFECTS.section()
    """An entry of the rig file, of the registered effect that its key `type` names."""
