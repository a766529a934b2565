"""Sections of the rig file; values are in bar, mm, degrees and volts, methods return SI."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator
from pydantic.json_schema import SkipJsonSchema

from model import variants
from model.units import PA_PER_BAR
from model.variants import VARIANTS
from protocols.arguments import shown
from protocols.problems import bad_input, closest
from protocols.validation import ValidationFault, faults
from rig.config.drivers import DeviceSection, Driver, DriverRegistry, resolved
from rig.config.tip_controllers import CONTROLLERS, FEED_FORWARD, KNOWN
from rig.sections.base import Section
from rig.sections.control import Patience
from rig.sections.plugins import RECORDED
from rig.sections.quantities import (
    ActuatorNumber,
    BarSpan,
    Count,
    Index,
    NonNegative,
    Number,
    Positive,
    RotationDeg,
    TranslationMm,
    Triple,
    VoltSpan,
    Word,
)


def _variant(name: str) -> str:
    variants.variant_named(name)
    return name


Variant = Annotated[str, AfterValidator(_variant), Field(json_schema_extra={"enum": list(VARIANTS)})]


def variant_named(name: str | None) -> Variant | None:
    """Return the model variant of a name, None for None; raise `BadInputError` for an unknown one."""
    if name is not None and not (isinstance(name, str) and name in VARIANTS):
        expected = f"one of {', '.join(VARIANTS)}"
        raise bad_input("--model", shown(name), expected, closest(str(name), VARIANTS))
    return name


class Sensor(Section):
    """A pressure sensor: gauge pressure is linear in voltage over the span, or is what the card gives (`unit: bar`).

    A voltage outside the electrical span by more than `margin_V` is a broken sensor or wire, not a pressure. A sensor
    in bar is broken outside its `span_bar` by more than 1 % of it.
    """

    actuator: ActuatorNumber
    card: Word
    channel: Index
    unit: Literal["V", "bar"] = Field(default="V", description="of the card's input")
    range_V: VoltSpan = (0.0, 10.0)
    span_V: VoltSpan = (0.0, 10.0)
    span_bar: BarSpan = (0.0, 10.0)
    margin_V: NonNegative = 0.1
    accuracy_bar: Positive = 0.01

    @property
    def signal_span(self) -> tuple[float, float]:
        """What the card gives at the ends of `span_bar`, in `unit`."""
        return self.span_V if self.unit == "V" else self.span_bar

    @property
    def signal_margin(self) -> float:
        """How far a working sensor may leave its span, in `unit`."""
        return self.margin_V if self.unit == "V" else 0.01 * (self.span_bar[1] - self.span_bar[0])

    @property
    def signal_range(self) -> tuple[float, float]:
        """Range of the card's input, in `unit`."""
        if self.unit == "V":
            return self.range_V
        (low, high), room = self.span_bar, 2 * self.signal_margin
        return low - room, high + room

    def pressure_pa(self, signal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gauge pressure [Pa] of a value of the card, in `unit`."""
        (v0, v1), (b0, b1) = self.signal_span, self.span_bar
        return (b0 + (signal - v0) * ((b1 - b0) / (v1 - v0))) * PA_PER_BAR

    @model_validator(mode="after")
    def _no_volts_in_bar(self) -> Sensor:
        volts = ("range_V", "span_V", "margin_V")
        if self.unit == "bar":
            other = (name for name in volts if getattr(self, name) != type(self).model_fields[name].default)
            faults(ValidationFault((name,), "no such key for a sensor with `unit: bar`") for name in other)
        return self


class LensConfig(Section):
    """Intrinsic parameters in pixels, OpenCV's five distortion coefficients (k1, k2, p1, p2, k3)."""

    fx_px: Positive
    fy_px: Positive
    cx_px: Number
    cy_px: Number
    distortion: tuple[Number, Number, Number, Number, Number] = (0.0, 0.0, 0.0, 0.0, 0.0)


class Placement(Section):
    """A rigid transform: a point x of this frame is R x + t in the parent frame; R from a rotation vector."""

    translation_mm: tuple[TranslationMm, TranslationMm, TranslationMm] = (0.0, 0.0, 0.0)
    rotation_deg: tuple[RotationDeg, RotationDeg, RotationDeg] = (0.0, 0.0, 0.0)
    translation_std_mm: NonNegative = 0.0
    rotation_std_deg: NonNegative = 0.0


class PlanarMotion(Section):
    """The plane of the rod-base frame in which the tip moves and turns; only for motion that keeps to it."""

    normal: Triple = (0.0, 1.0, 0.0)
    through_mm: Triple = (0.0, 0.0, 0.0)
    offset_std_mm: Positive = Field(description="how far the tip may leave the plane")
    tilt_std_deg: Positive = Field(description="how far the tip may turn out of the plane")


class CameraTrigger(Section):
    """A digital output of a card that triggers the exposures: the rising edge of each pulse begins one."""

    card: Word
    channel: Index
    width_ms: Positive | SkipJsonSchema[None] = Field(
        default=None, description="how long the output stays high, in whole control periods; default: one"
    )


def _name_drivers(schema: dict[str, Any]) -> None:
    """Add the names of softrig's drivers to a JSON schema; error messages quote them."""
    schema["enum"] = list(CAMERA_DRIVERS.built_in)


class CameraConfig(DeviceSection):
    """One camera. `placement` is the camera (x right, y down, z forward) in the rod-base frame."""

    driver: Annotated[str, Field(json_schema_extra=_name_drivers)]
    device: Word | Index
    width_px: Annotated[int, Field(ge=64, le=16384, strict=True)]
    height_px: Annotated[int, Field(ge=64, le=16384, strict=True)]
    rate_hz: Positive = 30.0
    exposure_ms: Positive = 8.0
    gain: NonNegative | SkipJsonSchema[None] = Field(
        default=None, description="in the driver's own unit; default: the setting that the camera has"
    )
    pixel_format: Annotated[str, Field(pattern=r"^[A-Z0-9 ]{4}$")] | SkipJsonSchema[None] = Field(
        default=None, description="V4L2's four letters, such as YUYV, MJPG, GREY; default: the driver's choice"
    )
    trigger: CameraTrigger | SkipJsonSchema[None] = Field(
        default=None, description="a card triggers the exposures, one pulse per frame; default: the camera's own clock"
    )
    lens: LensConfig
    placement: Placement
    planar_motion: PlanarMotion | SkipJsonSchema[None] = Field(
        default=None, description="the tip moves in a known plane: depth and tilt are no longer this camera's alone"
    )

    def serial(self) -> str | None:
        """Serial number of the camera as it is plugged in now; None where it has none or is not there."""
        serial = self.driven_by.serial
        return None if serial is None else resolved(serial)(self)


CAMERA_DRIVERS = DriverRegistry(
    "cameras",
    CameraConfig,
    {
        "opencv": Driver(
            CameraConfig,
            "rig.hardware.cameras.opencv:open_camera",
            "V4L2 cameras, folders of pictures and video files",
            examine="rig.doctor.cameras:examine_opencv",
            serial="rig.hardware.cameras.opencv:serial_of",
        ),
        "realsense": Driver(
            CameraConfig,
            "rig.hardware.cameras.realsense:open_camera",
            "Intel RealSense by librealsense (softrig[realsense])",
            examine="rig.doctor.cameras:examine_realsense",
            serial=lambda camera: str(camera.device),
        ),
        "mock": Driver(
            CameraConfig,
            "rig.simulator.mock_camera:open_mock_camera",
            "a camera of the simulated bench",
            simulated=True,
        ),
    },
)

if TYPE_CHECKING:
    AnyCamera = CameraConfig
else:
    AnyCamera = CAMERA_DRIVERS.section()
    """A camera of the rig file, by the model of its driver."""


class ModelConfig(Section):
    """The model that runs beside the rig."""

    variant: Variant = "inhomogeneous+rpe"
    mode: Literal["static", "dynamic"] = "dynamic"
    rate_hz: Number = Field(
        default=30.0,
        ge=1,
        le=1000,
        description="predictions per second of a rig without cameras; a camera gives its own rate",
    )


class Recording(Section):
    """Which camera frames are stored, and their encoding."""

    keep_every: Count = 3
    encoding: Literal["jpeg", "png"] = "jpeg"
    jpeg_quality: Annotated[int, Field(ge=1, le=100, strict=True)] = 90


_CLASS = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


class TipControlSection(Section):
    """How the tip follows the reference of a protocol's `tip` steps."""

    controller: Word = Field(default=FEED_FORWARD, description=f"{KNOWN}, or package:Class")
    delay_ms: Positive = Field(
        default=50.0, le=500, description="from the exposure of a frame to the plan that it leads to"
    )
    pressure_lag_ms: NonNegative = Field(
        default=10.0, le=500, description="from a moving set-point to the pressure in the chamber"
    )
    no_plan_s: Patience = Field(
        default=3.0, ge=0.5, description="longest time on a tip path without a plan; then the run ends"
    )

    @field_validator("controller")
    @classmethod
    def _known(cls, name: str, info: ValidationInfo) -> str:
        recorded = bool(info.context and info.context.get(RECORDED))
        if recorded or name in (FEED_FORWARD, *CONTROLLERS.built_in) or _CLASS.fullmatch(name) or name in CONTROLLERS:
            return name
        raise ValueError(f"one of {', '.join((FEED_FORWARD, *CONTROLLERS))}, or package:Class of your own")
