"""The calibration file: what each of its five kinds holds, with the unit of every number in its key."""

# ruff: noqa: N815 - volts keep their capital, as in V and mV

from __future__ import annotations

import itertools
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field, model_validator

from protocols.validation import ValidationFault, faults
from rig.config.board_sections import AnyPattern
from rig.config.sections import LensConfig, Placement
from rig.sections.base import Section
from rig.sections.quantities import (
    ActuatorNumber,
    Count,
    Index,
    Moment,
    NonNegative,
    Number,
    Positive,
    Triple,
    Volt,
    VoltSpan,
    Word,
)
from rig.valves.metering import flow_curve_faults

Row = tuple[Number, ...]
Matrix = tuple[Row, ...]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$", description="SHA-256, 64 hexadecimal digits")]


def _covariance(size: int) -> AfterValidator:
    """A validator of a covariance: its shape, its symmetry, its diagonal."""

    def checked(matrix: Matrix) -> Matrix:
        if len(matrix) != size or any(len(row) != size for row in matrix):
            faults([ValidationFault((), f"{size} rows of {size} numbers")])
        found = [ValidationFault((i, i), "a variance: 0 or more") for i in range(size) if matrix[i][i] < 0]
        for i, j in itertools.combinations(range(size), 2):
            a, b = matrix[i][j], matrix[j][i]
            if abs(a - b) > 1e-6 * max(abs(a), abs(b), 1e-300):
                expected = f"{b:g}, as row {j + 1}, column {i + 1}: a covariance is symmetric"
                found.append(ValidationFault((i, j), expected))
        faults(found)
        return matrix

    return AfterValidator(checked)


SensorCovariance = Annotated[Matrix, _covariance(2)]
PoseCovariance = Annotated[Matrix, _covariance(6)]
LensCovariance = Annotated[Matrix, _covariance(9)]
DLTCovariance = Annotated[Matrix, _covariance(11)]


class Software(Section):
    """The software that made the file; `git_changed`: the checkout differed from the commit."""

    versions: dict[str, str]
    git_commit: str = ""
    git_changed: Annotated[bool, Field(strict=True)] = False


class CameraIdentity(Section):
    """A camera and its resolution, with driver, device and serial number where these are known."""

    name: Word
    driver: Word | None = None
    device: Word | Index | None = None
    serial: Word | None = None
    width_px: Annotated[int, Field(ge=64, le=16384, strict=True)]
    height_px: Annotated[int, Field(ge=64, le=16384, strict=True)]


class CardIdentity(Section):
    """A data-acquisition card."""

    name: Word
    driver: Word
    device: Word


class SourceFileSection(Section):
    """A file that was used: control points, or another calibration."""

    name: Word
    sha256: Sha256


class UsedView(SourceFileSection):
    """A used picture, with the rms of the residuals of its corners."""

    corners: Count
    rms_px: NonNegative


class ExcludedViewSection(SourceFileSection):
    """A picture that was not used, and the reason."""

    reason: Word


class CalibrationFile(Section):
    """The fields of every calibration file."""

    softrig_calibration: Literal[1] = Field(description="version of this format")
    made: Moment
    software: Software
    command: str = ""
    note: str = ""


class CameraFile(CalibrationFile):
    """`rig calibrate camera`: intrinsics and distortion."""

    kind: Literal["camera"]
    camera: CameraIdentity
    board: AnyPattern
    lens: LensConfig
    covariance: LensCovariance = Field(description="of fx, fy, cx, cy [px], k1, k2, p1, p2, k3")
    rms_px: NonNegative
    coverage_percent: NonNegative = Field(le=100)
    views: Annotated[tuple[UsedView, ...], Field(min_length=1)]
    left_out: tuple[ExcludedViewSection, ...] = ()
    advice: tuple[Word, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> CameraFile:
        found = []
        for key, centre, size in (
            ("cx_px", self.lens.cx_px, self.camera.width_px),
            ("cy_px", self.lens.cy_px, self.camera.height_px),
        ):
            if not 0 < centre < size:
                found.append(ValidationFault(("lens", key), f"a centre inside the picture, 0 to {size} px"))
        faults(found)
        return self


class DLTCamera(Section):
    """One camera's 11 coefficients (world in mm, pixels without distortion) and its place in the world."""

    camera: CameraIdentity
    lens: LensConfig | None = Field(
        default=None, description="taken out first; none where the pixels were used as they are"
    )
    coefficients_px_mm: Annotated[tuple[Number, ...], Field(min_length=11, max_length=11)]
    covariance: DLTCovariance = Field(description="of the coefficients")
    rms_px: NonNegative
    placement: Placement = Field(description="the camera in the world")
    placement_covariance: PoseCovariance = Field(description="of translation [mm] and rotation vector [deg]")
    placement_known: Annotated[
        bool, Field(strict=True, description="whether the uncertainty of the placement is known")
    ] = True
    points: Annotated[
        tuple[Word, ...],
        Field(
            min_length=1,
            description="control points; or views of a board, each for all its corners in their order, or VIEW:CORNER",
        ),
    ]
    residuals_px: Annotated[
        tuple[Number, ...], Field(min_length=2, description="u, v of one point after the other, measured - projected")
    ]


class LeaveOneOut(Section):
    """Leave-one-out cross-validation of the calibration; edges are those of the squares or tags of a board."""

    method: Literal["leave one point out", "leave one view out"]
    points: Count
    rms_mm: NonNegative | None = None
    worst_mm: NonNegative | None = None
    rms_px: NonNegative | None = None
    edge_mm: Positive | None = None
    edge_std_mm: NonNegative | None = None


class DLTFile(CalibrationFile):
    """`rig calibrate dlt`: one or more cameras in one world frame."""

    kind: Literal["dlt"]
    world: Literal["rod base", "board"] = Field(description="the frame of the control points")
    world_view: str = Field(default="", description="view whose board is the world's frame")
    board: AnyPattern | None = None
    cameras: Annotated[tuple[DLTCamera, ...], Field(min_length=1)]
    test_error: LeaveOneOut | None = None
    views: tuple[UsedView, ...] = ()
    sources: tuple[SourceFileSection, ...] = ()
    left_out: tuple[ExcludedViewSection, ...] = ()


class ToolView(SourceFileSection):
    """A picture of the board on the tip, with its residuals."""

    pose: Literal["straight", "turned"]
    turned_deg: Number
    residual_mm: NonNegative
    residual_deg: NonNegative


class ToolFile(CalibrationFile):
    """`rig calibrate tool`: the board in the tip frame, whose z axis is the arm's central axis."""

    kind: Literal["tool"]
    camera: CameraIdentity
    board: AnyPattern
    placement: Placement
    covariance: PoseCovariance = Field(description="of translation [mm] and rotation vector [deg]")
    views: Annotated[tuple[ToolView, ...], Field(min_length=1)]
    left_out: tuple[ExcludedViewSection, ...] = ()


class GaugeLevel(Section):
    """One pressure at which sensor and gauge were read."""

    volts_V: Number
    gauge_bar: Number
    residual_bar: Number


class SensorCalibration(Section):
    """One sensor: pressure = offset_bar + scale_bar_per_V times the voltage."""

    actuator: ActuatorNumber
    card: CardIdentity
    channel: Index
    span_V: VoltSpan
    scale_bar_per_V: Number
    offset_bar: Number
    covariance: SensorCovariance = Field(description="of offset_bar and scale_bar_per_V")
    rms_bar: NonNegative
    levels: Annotated[tuple[GaugeLevel, ...], Field(min_length=2)]

    @model_validator(mode="after")
    def _check(self) -> SensorCalibration:
        if self.scale_bar_per_V == 0:
            faults([ValidationFault(("scale_bar_per_V",), "a scale other than 0")])
        return self


class FlowPoint(Section):
    """One voltage from closed_V of the sweep: the opening that the pressure's rate showed, negative towards exhaust."""

    offset_V: Number
    flow_l_min: Number
    std_l_min: NonNegative
    residual_l_min: Number


class ValveCalibration(Section):
    """One flow-metering valve, as a sweep of its voltage found it.

    Flows are those at 6 -> 5 bar, as data sheets state them. Every flow is proportional to `volume_ml`, whose
    uncertainty is not in the others; beyond `measured_to_V` the curve is the rig's, scaled to join.
    """

    valve: Count
    card: CardIdentity
    channel: Index
    closed_V: Volt
    closed_std_V: NonNegative
    dead_zone_V: NonNegative
    dead_zone_std_V: NonNegative
    hysteresis_V: NonNegative
    leakage_l_min: NonNegative
    leakage_std_l_min: NonNegative
    full_flow_l_min: Positive
    flow_curve_V: Annotated[tuple[NonNegative, ...], Field(min_length=2)]
    flow_curve_percent: Annotated[tuple[NonNegative, ...], Field(min_length=2)]
    flow_curve_std_percent: Annotated[tuple[NonNegative, ...], Field(min_length=2)]
    measured_to_V: NonNegative
    volume_ml: Positive
    volume_std_ml: NonNegative
    supply_bar: Positive
    rms_l_min: NonNegative
    points: Annotated[tuple[FlowPoint, ...], Field(min_length=2)]

    @model_validator(mode="after")
    def _check(self) -> ValveCalibration:
        found = list(flow_curve_faults(self.flow_curve_V, self.flow_curve_percent, self.dead_zone_V))
        std = self.flow_curve_std_percent
        if len(std) != len(self.flow_curve_V):
            expected = f"{len(self.flow_curve_V)} values, as many as flow_curve_V has, not {len(std)}"
            found.append(ValidationFault(("flow_curve_std_percent",), expected))
        faults(found)
        return self


class PressureFile(CalibrationFile):
    """`rig calibrate pressure`: sensors against a reference gauge, valves by a sweep."""

    kind: Literal["pressure"]
    gauge: str = Field(default="", description="name and number of the reference gauge")
    gauge_std_bar: NonNegative = 0.0
    sensors: tuple[SensorCalibration, ...] = ()
    valves: tuple[ValveCalibration, ...] = ()
    sources: tuple[SourceFileSection, ...] = ()


class GravityFile(CalibrationFile):
    """`rig import` of a table with a load cell: the direction of gravity in the rod-base frame."""

    kind: Literal["gravity"]
    direction: Triple
    std_deg: Positive = Field(le=180, description="about each axis across it")
    readings: Count = Field(description="of the load cell at rest")
    carried_g: NonNegative | None = Field(default=None, description="mass that the cell carries beside known weights")
    source: SourceFileSection

    @model_validator(mode="after")
    def _check(self) -> GravityFile:
        if not any(self.direction):
            faults([ValidationFault(("direction",), "a direction, such as [0, 0, 1]")])
        return self


AnyFile = CameraFile | DLTFile | ToolFile | PressureFile | GravityFile
KINDS: dict[str, type[AnyFile]] = {get_args(one.model_fields["kind"].annotation)[0]: one for one in get_args(AnyFile)}
