"""The arm in the rig file: its segments, and the law of the push of the pressures."""

# ruff: noqa: N815 - newton keeps its capital, as in 1/N

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator
from pydantic.config import JsonDict
from pydantic.json_schema import SkipJsonSchema

from model.actuation import ACTUATION_LAWS, MOST_STOPS, ActuationLaw, Proportional, StopElement, actuation_law_named
from model.material import MOST_BRANCHES
from model.units import PA_PER_BAR
from protocols.validation import ValidationFault, faults
from rig.sections.base import Section
from rig.sections.quantities import Flag, LengthMm, MassG, ModulusPa, NonNegative, Number, Triple


class GeometryConfig(Section):
    """The arm's Table 1: actuators on a circle, in degrees from the base frame's x axis."""

    length_mm: LengthMm
    inner_radius_mm: LengthMm
    outer_radius_mm: LengthMm
    circle_radius_mm: LengthMm = Field(description="b / sqrt 3")
    actuator_angles_deg: Annotated[tuple[Number, ...], Field(min_length=1)]


class BranchConfig(Section):
    """A Maxwell branch of the walls, one term of a Prony series."""

    relative_modulus: NonNegative = Field(le=10, description="over the modulus at rest")
    time_s: Number = Field(ge=1e-3, le=1e5, description="relaxation time")


class MaterialConfig(Section):
    """Eqs 16, 30, 32, the identified gamma, and what makes the walls viscous."""

    youngs_modulus_pa: ModulusPa = Field(description="homogeneous section")
    a1_per_N: Number = Field(ge=1e-6, le=10, description="eq 32")
    a2_per_N2: NonNegative = Field(le=1_000, description="eq 32")
    rpe_per_bar: Number = Field(ge=-10, le=10, description="a of eq 30")
    shear_ratio: Number = Field(ge=0.01, le=100, description="gamma = G / E")
    density_kg_m3: Number = Field(default=1080.0, ge=1, le=25_000)
    damping_s: NonNegative = Field(default=0.0, le=10, description="Kelvin-Voigt retardation time")
    branches: Annotated[tuple[BranchConfig, ...], Field(max_length=MOST_BRANCHES)] = Field(
        default=(), description="Prony series of the walls' slow relaxation"
    )


def _actuation_law(name: str) -> str:
    actuation_law_named(name)
    return name


class StopElementConfig(Section):
    """A stop element of every actuator: a spring in series with a slider."""

    weight: NonNegative = Field(le=1, description="share of the pressure that the spring takes")
    width_bar: Number = Field(ge=1e-4, le=100, description="pressure at which the slider slips")


class ActuationConfig(Section):
    """Law of the push of the pressures on the caps, and friction of the actuators."""

    law: Annotated[str, AfterValidator(_actuation_law), Field(json_schema_extra={"enum": list(ACTUATION_LAWS)})] = (
        Proportional.name
    )
    growth_per_bar: Number = Field(default=0.0, ge=-0.5, le=5, description="k, relative growth of the push per bar")
    stops: Annotated[tuple[StopElementConfig, ...], Field(max_length=MOST_STOPS)] = Field(
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


class CouplingConfig(Section):
    """A rigid body on the axis of the arm between a segment and the one before it, its mass half-way along it."""

    length_mm: NonNegative = Field(default=0.0, le=10_000)
    mass_g: MassG = 0.0


class SegmentConfig(Section):
    """A part of the arm that is the same along its length; its chambers act on it alone."""

    geometry: GeometryConfig
    material: MaterialConfig
    coupling: CouplingConfig = Field(
        default=CouplingConfig(), description="to the segment before; none for the first one"
    )


EITHER_SEGMENTS: JsonDict = {"if": {"required": ["segments"]}, "else": {"required": ["geometry", "material"]}}
"""JSON schema: the keys of the one segment, or a list of segments."""


class ArmConfig(Section):
    """The manipulator. `gravity_direction` is that of the weight in the rod-base frame."""

    model_config = ConfigDict(json_schema_extra=EITHER_SEGMENTS)

    geometry: GeometryConfig | SkipJsonSchema[None] = Field(default=None, description="of an arm of one segment")
    material: MaterialConfig | SkipJsonSchema[None] = Field(default=None, description="of an arm of one segment")
    segments: Annotated[tuple[SegmentConfig, ...], Field(min_length=1)] | SkipJsonSchema[None] = Field(
        default=None, description="from the base to the tip, in place of `geometry` and `material`"
    )
    actuation: ActuationConfig = ActuationConfig()
    cap_mass_g: MassG = 50.0
    gravity_direction: Triple = (0.0, 0.0, 1.0)
    gravity_on_rod: Flag = False

    @model_validator(mode="after")
    def _either(self) -> Self:
        own = {"geometry": self.geometry, "material": self.material}
        faults(segment_faults(own, tuple(own), listed=self.segments is not None))
        if self.segments is not None and self.segments[0].coupling != CouplingConfig():
            expected = "no coupling in the first segment, which is clamped: `coupling` is to the segment before"
            faults([ValidationFault(("segments", 0, "coupling"), expected)])
        return self

    @property
    def chain(self) -> tuple[SegmentConfig, ...]:
        """The segments from the base to the tip, in whichever form the file has them."""
        if self.segments is not None:
            return self.segments
        assert self.geometry is not None
        assert self.material is not None
        return (SegmentConfig.model_construct(geometry=self.geometry, material=self.material),)

    def path(self, segment: int) -> tuple[str | int, ...]:
        """Where the keys of a segment are in this section."""
        return () if self.segments is None else ("segments", segment)

    @property
    def actuators(self) -> int:
        """Number of actuators of all segments."""
        return sum(len(segment.geometry.actuator_angles_deg) for segment in self.chain)

    @property
    def length_mm(self) -> float:
        """Length of the arm at rest, with its couplings."""
        return sum(segment.geometry.length_mm + segment.coupling.length_mm for segment in self.chain)


def segment_faults(own: Mapping[str, object], needed: Sequence[str], *, listed: bool) -> Iterator[ValidationFault]:
    """Yield a fault for each key of the one segment that is missing, or that stands beside a list of segments.

    own: the keys of the one segment and their values. needed: those of them that it must have.
    """
    if not listed:
        for name in needed:
            if own[name] is None:
                yield ValidationFault((name,), f"is missing: {name} of the one segment, or a list of `segments`")
        return
    for name, value in own.items():
        if value is not None:
            yield ValidationFault((name,), "no such key beside `segments`: each segment has its own")
