"""Section of the rig file on the arm, and on how the pressures act on it."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from model.actuation import ACTUATION_LAWS, ActuationLaw, Proportional, actuation_law_named
from rig.config.sections import Flag, GeometryConfig, MassG, MaterialConfig, Section, Triple


def _actuation_law(name: str) -> str:
    actuation_law_named(name)
    return name


class ActuationConfig(Section):
    """Law of the push of the pressures on the caps."""

    law: Annotated[str, AfterValidator(_actuation_law), Field(json_schema_extra={"enum": list(ACTUATION_LAWS)})] = (
        Proportional.name
    )
    growth_per_bar: Annotated[float, Field(ge=-0.5, le=5, allow_inf_nan=False, strict=True)] = Field(
        default=0.0, description="k, relative growth of the push per bar"
    )

    @model_validator(mode="after")
    def _check_growth(self) -> Self:
        self.as_law()
        return self

    def as_law(self) -> ActuationLaw:
        """Return the law; ValueError for a growth that it does not have."""
        return actuation_law_named(self.law)(self.growth_per_bar)


class ArmConfig(Section):
    """The manipulator. `gravity_direction` is that of the weight in the rod-base frame."""

    geometry: GeometryConfig
    material: MaterialConfig
    actuation: ActuationConfig = ActuationConfig()
    cap_mass_g: MassG = 50.0
    gravity_direction: Triple = (0.0, 0.0, 1.0)
    gravity_on_rod: Flag = False
