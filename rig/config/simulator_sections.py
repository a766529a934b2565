"""Sections of the rig file about the simulator: the truth behind the mock devices."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.validation import faults
from rig.arm_effects.registry import ArmEffectEntry
from rig.config.arm_sections import GeometryConfig, MaterialConfig, segment_faults
from rig.config.input_sections import SimulatedInput
from rig.config.sections import LensConfig, Placement, Sensor
from rig.sections.base import Section
from rig.sections.quantities import MassG, NonNegative, Number, Positive
from rig.valves.base import SimulatedValve
from rig.valves.registry import Valve


class SimulatedChamber(Section):
    """True parameters of every chamber."""

    dead_volume_ml: NonNegative = Field(le=10_000)
    tube_l_s_bar: Number = Field(
        default=0.5, ge=1e-3, le=1e6, description="sonic conductance of the tube from valve to chamber"
    )
    temperature_k: Number = Field(default=293.15, ge=200, le=400)
    polytropic: Number = Field(default=1.0, ge=1, le=1.4)


class SimulatedSensor(Section):
    """True parameters of every pressure sensor."""

    noise_bar: NonNegative
    offset_bar: NonNegative = Field(default=0.0, description="standard deviation of the sensors' offsets")
    lag_ms: NonNegative = Field(le=10_000)


class SimulatedScene(Section):
    """True parameters of the image."""

    blur_px: NonNegative = Field(le=50)
    noise_grey: NonNegative = Field(le=255)
    lighting: Positive = Field(default=0.9, le=1)
    skew_ms: NonNegative = Field(default=0.0, description="virtual time: each camera exposes so long after the last")
    stamp_delay_ms: NonNegative = Field(
        default=0.0, description="how much later than the true one the mid-exposure is that a camera's driver gives"
    )


class AsBuiltSection(Section):
    """True parts of the simulator, where a calibration replaced the stated ones."""

    lenses: dict[str, LensConfig]
    valves: tuple[Valve, ...]
    sensors: tuple[Sensor, ...]


class SimulatedSegment(Section):
    """True parameters of a segment of the arm; its coupling is the one stated."""

    material: MaterialConfig
    geometry: GeometryConfig | SkipJsonSchema[None] = Field(
        default=None, description="true geometry; default: the segment's"
    )


class Simulator(Section):
    """The simulated plant of the mock devices. Its parameters intentionally differ from the model's."""

    model_config = ConfigDict(json_schema_extra={"if": {"required": ["segments"]}, "else": {"required": ["material"]}})

    valve: SimulatedValve
    chamber: SimulatedChamber
    sensor: SimulatedSensor
    inputs: dict[str, SimulatedInput] = Field(default={}, description="true values of the auxiliary inputs, by name")
    scene: SimulatedScene | SkipJsonSchema[None] = Field(default=None, description="of the simulated cameras")
    material: MaterialConfig | SkipJsonSchema[None] = Field(default=None, description="of an arm of one segment")
    segments: Annotated[tuple[SimulatedSegment, ...], Field(min_length=1)] | SkipJsonSchema[None] = Field(
        default=None, description="truth of each segment of the arm, in place of `material` and `geometry`"
    )
    cap_mass_g: MassG
    arm_effects: tuple[ArmEffectEntry, ...] = Field(
        default=(),
        description="what the arm does beyond the rod model, in the order in which they act on the pressures",
    )
    camera_errors: dict[str, Placement] = Field(
        default={}, description="true placement of each camera beyond the stated one, by its name"
    )
    built: AsBuiltSection | SkipJsonSchema[None] = Field(default=None, description="true parts; default: those stated")
    geometry: GeometryConfig | SkipJsonSchema[None] = Field(
        default=None, description="true geometry; default: the arm's"
    )
    base: Placement = Field(default=Placement(), description="true rod base in the frame that the rig takes for it")
    board: Placement | SkipJsonSchema[None] = Field(
        default=None, description="true placement of the board; default: the one stated"
    )

    @model_validator(mode="after")
    def _either(self) -> Self:
        own = {"geometry": self.geometry, "material": self.material}
        faults(segment_faults(own, ("material",), listed=self.segments is not None))
        return self

    @property
    def chain(self) -> tuple[SimulatedSegment, ...]:
        """The truth of the segments from the base to the tip, in whichever form the file has it."""
        if self.segments is not None:
            return self.segments
        assert self.material is not None
        return (SimulatedSegment.model_construct(material=self.material, geometry=self.geometry),)

    def path(self, segment: int) -> tuple[str | int, ...]:
        """Where the keys of a segment are in this section."""
        return () if self.segments is None else ("segments", segment)

    def error_of(self, camera: str) -> Placement:
        """Return the offset of a camera's true placement from the stated one."""
        return self.camera_errors.get(camera, Placement())
