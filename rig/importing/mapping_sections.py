"""Sections of the mapping of an import: what a column, or a group of columns, of a foreign table is."""

# ruff: noqa: N815 - newton keeps its capital

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.validation import ValidationFault, faults
from rig.importing.units import ForceUnit, LengthUnit, MassUnit, MomentUnit, PressureUnit, TimeUnit, VoltUnit
from rig.sections.base import Section
from rig.sections.quantities import Bar, Count, Flag, Index, NonNegative, Positive, Triple, Word


def _list_or_one(value: Any) -> str:
    return "each" if isinstance(value, list | tuple) else "all"


T = TypeVar("T")
OneOrEach = Annotated[Annotated[T, Tag("all")] | Annotated[tuple[T, ...], Tag("each")], Discriminator(_list_or_one)]
"""One for all columns, or a list with one for each."""
PressureUnits = OneOrEach[PressureUnit]
LengthUnits = OneOrEach[LengthUnit]
AmbientBar = OneOrEach[Bar]
Uncertainty = Annotated[
    Annotated[NonNegative, Tag("all")] | Annotated[tuple[NonNegative, NonNegative, NonNegative], Tag("each")],
    Discriminator(_list_or_one),
]


def _number_or_name(value: Any) -> str:
    return "number" if isinstance(value, int) else "name"


def _interval(value: tuple[float, float]) -> tuple[float, float]:
    if not 0 <= value[0] < value[1]:
        raise ValueError("begin and end of a time, 0 or more, such as [2.5, 10]")
    return value


Second = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Interval = Annotated[tuple[Second, Second], AfterValidator(_interval)]
"""Begin and end [s]."""

Column = Annotated[Annotated[Index, Tag("number")] | Annotated[Word, Tag("name")], Discriminator(_number_or_name)]
"""A column by its number, or by its name."""


class TableFormat(Section):
    """How the file is written. Everything but `variable` and `first_column` is about CSV."""

    first_column: Annotated[int, Field(ge=0, le=1, strict=True)] | SkipJsonSchema[None] = Field(
        default=None, description="number of the first column, where columns are given by number"
    )
    variable: Word | SkipJsonSchema[None] = Field(default=None, description="of the .mat file: a matrix or a struct")
    delimiter: Literal["comma", "semicolon", "tab", "bar", "space"] | SkipJsonSchema[None] = Field(
        default=None, description="found automatically if left out"
    )
    decimal: Literal["point", "comma"] = "point"
    header: Flag = Field(default=True, description="the first line names the columns")
    skip_lines: Index = Field(default=0, description="lines before the header")
    lines_after_header: Index = Field(default=0, description="lines between header and numbers, such as one of units")
    comment: Word | SkipJsonSchema[None] = Field(default=None, description="how a line begins that is no data")
    missing: tuple[str, ...] = Field(default=(), description="cells that mean 'not measured', beside empty and nan")


class RowTime(Section):
    """When each row was taken: a column and its unit, or the period of a table without a clock."""

    column: Column | SkipJsonSchema[None] = None
    unit: Literal[TimeUnit, "iso"] | SkipJsonSchema[None] = Field(
        default=None, description="iso: date and time in ISO 8601, to the microsecond"
    )
    period_ms: Annotated[float, Field(ge=1e-3, le=3_600_000, strict=True)] | SkipJsonSchema[None] = Field(
        default=None, description="time from row to row, of a table without a clock"
    )

    @model_validator(mode="after")
    def _check(self) -> RowTime:
        if self.period_ms is None:
            absent = [name for name in ("column", "unit") if getattr(self, name) is None]
            expected = "is missing: a column and its unit, or period_ms for a table without a clock"
            faults(ValidationFault((name,), expected) for name in absent)
        else:
            given = [name for name in ("column", "unit") if getattr(self, name) is not None]
            faults(ValidationFault((name,), "nothing: period_ms is for a table without a clock") for name in given)
        return self


class WeightColumn(Section):
    """Weight on the end cap."""

    column: Column
    unit: MassUnit


class PressureColumnsSection(Section):
    """Measured pressure of every actuator, in the order of the actuators.

    From absolute pressures the ambient pressure is subtracted: a stated one, or each column's mean over its first rows.
    """

    columns: Annotated[tuple[Column, ...], Field(min_length=1)]
    unit: PressureUnits
    reading: Literal["absolute", "gauge"]
    ambient_rows: Count | SkipJsonSchema[None] = Field(default=None, description="first rows, with the arm vented")
    ambient_bar: AmbientBar | SkipJsonSchema[None] = Field(default=None, description="of all columns, or of each")
    delay_s: Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False, strict=True)] | Literal["measured"] = Field(
        default=0.0,
        description="time by which the columns lead the tip, as of another logger or long tubes; measured: as the "
        "changes of pressures and tip in the table show it",
    )

    @model_validator(mode="after")
    def _check(self) -> PressureColumnsSection:
        given = [name for name in ("ambient_rows", "ambient_bar") if getattr(self, name) is not None]
        found = _units(self.columns, self.unit)
        if self.reading == "gauge":
            found += [
                ValidationFault((name,), "nothing: gauge pressures contain no ambient pressure") for name in given
            ]
        elif not given:
            found.append(ValidationFault((), "absolute pressures need ambient_rows or ambient_bar"))
        elif len(given) == 2:
            found.append(ValidationFault(("ambient_bar",), "ambient_rows or ambient_bar, not both"))
        if isinstance(self.ambient_bar, tuple) and len(self.ambient_bar) != len(self.columns):
            expected = f"one pressure, or one for each of the {len(self.columns)} columns, not {len(self.ambient_bar)}"
            found.append(ValidationFault(("ambient_bar",), expected))
        faults(found)
        return self


class SetPoints(Section):
    """Gauge set-point of every actuator."""

    columns: Annotated[tuple[Column, ...], Field(min_length=1)]
    unit: PressureUnits

    @model_validator(mode="after")
    def _check(self) -> SetPoints:
        faults(_units(self.columns, self.unit))
        return self


class Valves(Section):
    """Commanded voltage of every valve."""

    columns: Annotated[tuple[Column, ...], Field(min_length=1)]
    unit: VoltUnit


class Position(Section):
    """Where a sensor is: its x, y and z."""

    columns: tuple[Column, Column, Column]
    unit: LengthUnits

    @model_validator(mode="after")
    def _check(self) -> Position:
        faults(_units(self.columns, self.unit))
        return self


def _order(text: str) -> str:
    euler = len(text) == 3 and set(text.lower()) <= set("xyz") and text in (text.lower(), text.upper())
    if text in ("wxyz", "xyzw", "matrix", "vector") or (euler and text[0] != text[1] != text[2]):
        return text
    raise ValueError("wxyz, xyzw, matrix, vector, or three Euler axes such as xyz or ZYX")


class Orientation(Section):
    """Rotation from the sensor's axes to the tracker's.

    `order`: a unit quaternion as `wxyz` or `xyzw`; a rotation `matrix`, nine columns row by row; a rotation `vector`;
    or three Euler angles, about fixed axes (`xyz`, `zyz`, ..) or about rotating axes (`ZYX`, ..), in this order.
    """

    columns: Annotated[tuple[Column, ...], Field(min_length=3, max_length=9)]
    order: Annotated[str, AfterValidator(_order)]
    unit: Literal["deg", "rad"] | SkipJsonSchema[None] = Field(default=None, description="of angles")

    @model_validator(mode="after")
    def _check_columns(self) -> Orientation:
        found = []
        wanted = {"wxyz": 4, "xyzw": 4, "matrix": 9}.get(self.order, 3)
        if len(self.columns) != wanted:
            found.append(ValidationFault(("columns",), f"{wanted} columns for '{self.order}'"))
        if (wanted == 3) != (self.unit is not None):
            found.append(
                ValidationFault(("unit",), "deg or rad" if wanted == 3 else "nothing: only angles have a unit")
            )
        faults(found)
        return self


class BaseOrientation(Orientation):
    """Orientation of the base sensor; `ignore` it if it is unreliable or the base does not move."""

    use: Literal["turn", "ignore"] = "turn"


class TipOrientation(Orientation):
    """Orientation of the tip sensor; with `uncertainty_deg` the archive keeps that of the tip.

    How the sensor is mounted: `rotation_deg`, the rotation vector from the axes of the tip to those of the sensor; or
    `aligned_rows`, the first rows, in which the axes of the tip are parallel to those of the rod base.
    """

    uncertainty_deg: Positive | SkipJsonSchema[None] = Field(default=None, description="standard, about each axis")
    aligned_rows: Count | SkipJsonSchema[None] = Field(
        default=None, description="first rows, in which the axes of the tip are parallel to those of the rod base"
    )
    rotation_deg: Triple | SkipJsonSchema[None] = Field(
        default=None, description="rotation vector, from the axes of the tip to those of the sensor"
    )

    @model_validator(mode="after")
    def _check_mounting(self) -> TipOrientation:
        given = [name for name in ("aligned_rows", "rotation_deg") if getattr(self, name) is not None]
        if self.uncertainty_deg is None:
            expected = "uncertainty_deg beside it: it keeps the orientation of the tip"
            faults(ValidationFault((name,), expected) for name in given)
        elif len(given) != 1:
            expected = "rotation_deg or aligned_rows beside it, one of them: how the sensor is mounted on the tip"
            faults([ValidationFault(("uncertainty_deg",), expected)])
        return self


class BaseSensor(Section):
    """The sensor at the rod's base: its position is subtracted from the tip's, its orientation rotates the result."""

    position: Position
    orientation: BaseOrientation | SkipJsonSchema[None] = None
    uncertainty_mm: Uncertainty | SkipJsonSchema[None] = Field(default=None, description="standard, per axis")


class TipSensor(Section):
    """The sensor at the tip; `offset_mm` is the tool centre point in the sensor's own axes."""

    position: Position
    orientation: TipOrientation | SkipJsonSchema[None] = None
    offset_mm: Triple | SkipJsonSchema[None] = None
    uncertainty_mm: Uncertainty | SkipJsonSchema[None] = Field(default=None, description="standard, per axis")

    @model_validator(mode="after")
    def _check(self) -> TipSensor:
        if self.offset_mm is not None and self.orientation is None:
            faults(
                [ValidationFault(("offset_mm",), "an orientation beside it: the offset is along the sensor's own axes")]
            )
        return self


class Force(Section):
    """Measured force: its x, y and z."""

    columns: tuple[Column, Column, Column]
    unit: ForceUnit


class Torque(Section):
    """Measured moment: its x, y and z."""

    columns: tuple[Column, Column, Column]
    unit: MomentUnit


class LoadCell(Section):
    """A load cell: its force columns, and its axes.

    `axes`: of the rod base; of the tracker (of the base sensor, where its orientation is used); or of the tip sensor,
    turning with it. For a cell with another orientation: `rotation_deg`, the rotation vector from its axes to the named
    ones; or, on the tip, `aligned_rows`, the first rows, in which its axes are parallel to the tracker's.
    """

    force: Force
    axes: Literal["rod_base", "tracker", "tip"]
    aligned_rows: Count | SkipJsonSchema[None] = Field(
        default=None, description="first rows, in which the load cell's axes are parallel to the tracker's"
    )
    rotation_deg: Triple | SkipJsonSchema[None] = Field(
        default=None, description="rotation vector, from the load cell's axes to those named by axes"
    )

    @model_validator(mode="after")
    def _check_axes(self) -> LoadCell:
        if self.aligned_rows is not None:
            if self.axes != "tip":
                expected = f"nothing: only a cell on the tip turns; its axes are those of the {self.axes}"
                faults([ValidationFault(("aligned_rows",), expected)])
            elif self.rotation_deg is not None:
                faults([ValidationFault(("rotation_deg",), "aligned_rows or rotation_deg, not both")])
        return self


class Wrench(LoadCell):
    """A measured wrench at the tip. `at_mm` is the place of the cell, from the tool centre point along its axes."""

    moment: Torque | SkipJsonSchema[None] = None
    on: Literal["arm", "surroundings"] = Field(default="arm", description="the body that the measured force acts on")
    at_mm: Triple = (0.0, 0.0, 0.0)
    zero_rows: Count | SkipJsonSchema[None] = Field(
        default=None, description="first rows, without load: their mean is subtracted"
    )


class WeighingCell(LoadCell):
    """A load cell that carries a weight: the arm, or a body on its tip."""

    reads: Literal["weight", "reaction"] = Field(
        description="weight: what the cell carries reads along gravity; reaction: against it"
    )


class Gravity(Section):
    """Direction of gravity, from a load cell while nothing but weight acts on it.

    It follows from known weights (the column `weight`), from the orientations of a cell that turns with the tip, or
    from its reading without what it carries, `zero_N`.
    """

    cell: WeighingCell | SkipJsonSchema[None] = Field(default=None, description="left out: the cell of the wrench")
    at_rest_s: Annotated[tuple[Interval, ...], Field(min_length=1)] | SkipJsonSchema[None] = Field(
        default=None, description="begin and end of each time at rest, from the first row; left out: all rows"
    )
    zero_N: Triple | SkipJsonSchema[None] = Field(
        default=None, description="reading without what the cell carries; left out: it is estimated"
    )
    zero_std_N: Positive | SkipJsonSchema[None] = Field(default=None, description="standard, of each axis of zero_N")
    rotation_std_deg: Positive = Field(
        default=1.7, description="standard uncertainty of the cell's axes in the rod-base frame, with its cross-talk"
    )

    @model_validator(mode="after")
    def _check(self) -> Gravity:
        if (self.zero_N is None) != (self.zero_std_N is None):
            absent, given = ("zero_N", "zero_std_N") if self.zero_N is None else ("zero_std_N", "zero_N")
            faults([ValidationFault((absent,), f"is missing: {given} needs it")])
        return self


def _units(columns: tuple[int | str, ...], unit: str | tuple[str, ...]) -> list[ValidationFault]:
    if isinstance(unit, tuple) and len(unit) != len(columns):
        return [ValidationFault(("unit",), f"one unit, or one for each of the {len(columns)} columns, not {len(unit)}")]
    return []
