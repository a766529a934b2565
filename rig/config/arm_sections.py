"""Section of the rig file on the arm, and on how the pressures act on it."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from model.actuation import ACTUATION_LAWS, MOST_STOPS, ActuationLaw, Proportional, StopElement, actuation_law_named
from model.units import PA_PER_BAR
from rig.config.sections import GeometryConfig, MaterialConfig
from rig.sections.base import Section
from rig.sections.quantities import Flag, MassG, Triple


def _actuation_law(name: str) -> str:
    actuation_law_named(name)
    return name


class StopConfig(Section):
    """A stop element of every actuator: a spring in series with a slider."""

    weight: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False, strict=True)] = Field(
        description="share of the pressure that the spring takes"
    )
    width_bar: Annotated[float, Field(ge=1e-4, le=100, allow_inf_nan=False, strict=True)] = Field(
        description="pressure at which the slider slips"
    )


class ActuationConfig(Section):
    """Law of the push of the pressures on the caps, and friction of the actuators."""

    law: Annotated[str, AfterValidator(_actuation_law), Field(json_schema_extra={"enum": list(ACTUATION_LAWS)})] = (
        Proportional.name
    )
    growth_per_bar: Annotated[float, Field(ge=-0.5, le=5, allow_inf_nan=False, strict=True)] = Field(
        default=0.0, description="k, relative growth of the push per bar"
    )
    stops: Annotated[tuple[StopConfig, ...], Field(max_length=MOST_STOPS)] = Field(
        default=(), description="Prandtl-Ishlinskii elements of the hysteresis"
    )

    @model_validator(mode="after")
    def _check_growth(self) -> Self:
        self.as_law()
        return self

    def as_law(self) -> ActuationLaw:
        """Return the law; ValueError for a growth that it does not have."""
        stops = tuple(StopElement(stop.weight, stop.width_bar * PA_PER_BAR) for stop in self.stops)
        return actuation_law_named(self.law)(self.growth_per_bar, stops)


class ArmConfig(Section):
    """The manipulator. `gravity_direction` is that of the weight in the rod-base frame."""

    geometry: GeometryConfig
    material: MaterialConfig
    actuation: ActuationConfig = ActuationConfig()
    cap_mass_g: MassG = 50.0
    gravity_direction: Triple = (0.0, 0.0, 1.0)
    gravity_on_rod: Flag = False
