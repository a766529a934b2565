"""A step that gives a path of the tip, and the shapes of the path, in mm in the rod-base frame."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.arrays import Array
from protocols.problems import BadInputError, Problem
from protocols.steps.base import MotionStep, Positive, Seconds, SecondsOrNone, StepPart, Text, one_of
from protocols.steps.csv_samples import read_columns
from protocols.tip_paths import HarmonicPath, PiecewisePath, TipPath, closed_polyline, length_m
from protocols.trajectory_builder import TrajectoryBuilder
from protocols.validation import ValidationFault, faults

M_PER_MM = 1e-3
FARTHEST_MM = 10_000.0
SAME_M = 1e-5
"""First and last point of a path that repeats are equal within this: they may be rounded."""

Millimetres = Annotated[float, Field(ge=-FARTHEST_MM, le=FARTHEST_MM, allow_inf_nan=False, strict=True)]
Length = Annotated[float, Field(gt=0, le=FARTHEST_MM, allow_inf_nan=False, strict=True)]
Degrees = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False, strict=True)]
Component = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False, strict=True)]
Point = tuple[Millimetres, Millimetres, Millimetres]
Coordinate = Literal["x", "y", "z"]
AXES: tuple[Coordinate, ...] = ("x", "y", "z")
SHAPES = ("circle", "figure_eight", "star", "points", "hold", "csv")


class TipShape(StepPart, ABC):
    """A shape with its own timing. A field of `TipStep` registers it."""

    @abstractmethod
    def path(self, data: Any) -> TipPath:
        """The path over time; data: the result of `read`."""

    def read(self, folder: Path) -> tuple[Any, dict[str, str]]:
        """Read the files that the shape names; as `LeafStep.read`."""
        return None, {}


class _Closed(TipShape):
    """A closed shape in a plane."""

    centre_mm: Point
    normal: tuple[Component, Component, Component] = Field(
        default=(0.0, 0.0, 1.0), description="of the plane; the shape turns about it as a right-handed screw"
    )
    rotation_deg: Degrees = Field(default=0.0, description="about the normal, from the x axis (y where that is normal)")
    period_s: Seconds | SkipJsonSchema[None] = None
    speed_mm_per_s: Positive | SkipJsonSchema[None] = Field(default=None, description="mean speed, instead of period_s")
    periods: Positive | SkipJsonSchema[None] = None
    duration_s: Seconds | SkipJsonSchema[None] = Field(default=None, description="instead of periods")

    @model_validator(mode="after")
    def _check_timing(self) -> _Closed:
        found = one_of(("period_s", "speed_mm_per_s"), (self.period_s, self.speed_mm_per_s))
        found += one_of(("periods", "duration_s"), (self.periods, self.duration_s))
        if np.linalg.norm(self.normal) < 1e-6:
            found.append(ValidationFault(("normal",), "a direction: three numbers, not all zero"))
        faults(found)
        return self

    def path(self, data: Any) -> TipPath:
        """The closed path; its period follows from its length where a speed is given."""
        period_s = self.period_s
        if period_s is None:
            assert self.speed_mm_per_s is not None
            period_s = length_m(self._path(1.0, 1.0)) / (self.speed_mm_per_s * M_PER_MM)
        return self._path(period_s, self.periods if self.periods is not None else (self.duration_s or 0.0) / period_s)

    @abstractmethod
    def _path(self, period_s: float, periods: float) -> TipPath: ...

    def _axes(self) -> tuple[Array, Array, Array]:
        """Centre [m] and the two axes of the plane (3,)."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        along = np.array([0.0, 1.0, 0.0]) if abs(normal[0]) > 0.999 else np.array([1.0, 0.0, 0.0])
        first = along - (along @ normal) * normal
        first /= np.linalg.norm(first)
        second = np.cross(normal, first)
        angle = math.radians(self.rotation_deg)
        turned = math.cos(angle) * first + math.sin(angle) * second
        return np.array(self.centre_mm) * M_PER_MM, turned, math.cos(angle) * second - math.sin(angle) * first


class Circle(_Closed):
    """A circle; it begins on its first axis."""

    radius_mm: Length

    def _path(self, period_s: float, periods: float) -> TipPath:
        centre, first, second = self._axes()
        radius = self.radius_mm * M_PER_MM
        return HarmonicPath(centre, radius * first[None], radius * second[None], period_s, periods * period_s)


class FigureEight(_Closed):
    """A figure eight (lemniscate of Gerono) of this width along its first axis; it begins at its crossing."""

    width_mm: Length
    height_mm: Length

    def _path(self, period_s: float, periods: float) -> TipPath:
        centre, first, second = self._axes()
        sines = np.array([0.5 * self.width_mm * M_PER_MM * first, 0.5 * self.height_mm * M_PER_MM * second])
        return HarmonicPath(centre, np.zeros((2, 3)), sines, period_s, periods * period_s)


class Star(_Closed):
    """A star with straight edges; at each corner the tip comes to rest."""

    radius_mm: Length
    inner_radius_mm: Length | SkipJsonSchema[None] = Field(default=None, description="0.4 of the radius if left out")
    points: Annotated[int, Field(ge=2, le=50, strict=True)] = 5

    def _path(self, period_s: float, periods: float) -> TipPath:
        centre, first, second = self._axes()
        inner = 0.4 * self.radius_mm if self.inner_radius_mm is None else self.inner_radius_mm
        corners = []
        for k in range(2 * self.points):
            angle, radius = math.pi * k / self.points, M_PER_MM * (inner if k % 2 else self.radius_mm)
            corners.append(centre + radius * (math.cos(angle) * first + math.sin(angle) * second))
        times = period_s * np.linspace(0.0, 1.0, 2 * self.points + 1)
        return PiecewisePath(times, closed_polyline(corners), smooth=True, repeats=periods, centre=centre)


class Points(TipShape):
    """Points, one after the other, each held for `dwell_s`; the way between two takes `move_s` or follows a speed.

    A `smooth` way begins and ends at rest; a `linear` one has a constant speed and sharp corners. With `periods` the
    tip returns to the first point and repeats the whole.
    """

    at_mm: Annotated[tuple[Point, ...], Field(min_length=2)]
    dwell_s: SecondsOrNone = 0.0
    move_s: Seconds | SkipJsonSchema[None] = None
    speed_mm_per_s: Positive | SkipJsonSchema[None] = Field(default=None, description="mean speed, instead of move_s")
    ways: Literal["smooth", "linear"] = "smooth"
    periods: Positive | SkipJsonSchema[None] = None

    @model_validator(mode="after")
    def _check(self) -> Points:
        found = one_of(("move_s", "speed_mm_per_s"), (self.move_s, self.speed_mm_per_s))
        for k, (before, after) in enumerate(pairwise(self.at_mm), start=1):
            if before == after:
                found.append(ValidationFault(("at_mm", k), "another point than the one before; dwell_s holds a point"))
        faults(found)
        return self

    def path(self, data: Any) -> TipPath:
        points = np.array(self.at_mm) * M_PER_MM
        if self.periods is not None:
            points = closed_polyline(list(points)) if (points[0] != points[-1]).any() else points
        times, corners = [0.0], [points[0]]
        for before, after in pairwise(points):
            if self.dwell_s > 0:
                times.append(times[-1] + self.dwell_s)
                corners.append(before)
            way_s = self.move_s
            if way_s is None:
                assert self.speed_mm_per_s is not None
                way_s = float(np.linalg.norm(after - before)) / (self.speed_mm_per_s * M_PER_MM)
            times.append(times[-1] + way_s)
            corners.append(after)
        if self.dwell_s > 0 and self.periods is None:
            times.append(times[-1] + self.dwell_s)
            corners.append(points[-1])
        return PiecewisePath(np.array(times), np.array(corners), self.ways == "smooth", self.periods)


class HeldPoint(TipShape):
    """One point, held."""

    at_mm: Point
    duration_s: Seconds

    def path(self, data: Any) -> TipPath:
        point = np.array(self.at_mm) * M_PER_MM
        return PiecewisePath(np.array([0.0, self.duration_s]), np.array([point, point]), smooth=True)


class PathFile(TipShape):
    """A path from a CSV file beside the protocol: columns `time_s`, `x_mm`, `y_mm` and `z_mm`, straight lines between
    the rows. With `speed_mm_per_s` the file needs no times. With `periods` the rows repeat: the last is the first.
    """

    file: Text = Field(description="path, relative to the protocol's folder")
    speed_mm_per_s: Positive | SkipJsonSchema[None] = Field(default=None, description="instead of a column time_s")
    periods: Positive | SkipJsonSchema[None] = None

    def path(self, data: Any) -> TipPath:
        times, points = data
        return PiecewisePath(times, points, smooth=False, repeats=self.periods)

    def read(self, folder: Path) -> tuple[tuple[Array, Array], dict[str, str]]:
        """Times (k,) [s] and points (k, 3) [m]; and the text of the file."""
        coordinates = dict.fromkeys(("x_mm", "y_mm", "z_mm"), (-FARTHEST_MM, FARTHEST_MM, "mm"))
        columns, text = read_columns(folder / self.file, coordinates, timed=self.speed_mm_per_s is None)
        points = np.column_stack(columns[-3:]) * M_PER_MM
        if fault := self._fault(points):
            lines = [number for number, row in enumerate(text.split("\n"), start=1) if row.strip()]
            x, y, z = (f"{round(value / M_PER_MM, 3):g}" for value in points[-1])
            raise BadInputError([Problem(str(folder / self.file), lines[-1], 1, "", f"{x}, {y}, {z} mm", fault)])
        if self.periods is not None:
            points[-1] = points[0]
        if self.speed_mm_per_s is not None:
            points = points[np.r_[True, (np.diff(points, axis=0) != 0).any(axis=1)]]
            ways = np.linalg.norm(np.diff(points, axis=0), axis=1)
            times = np.r_[0.0, np.cumsum(ways)] / (self.speed_mm_per_s * M_PER_MM)
        else:
            times = np.array(columns[0])
        return (times, points), {self.file: text}

    def _fault(self, points: Array) -> str:
        """Expectation for the last point; empty if the points can be followed."""
        if self.speed_mm_per_s is not None and (points == points[0]).all():
            return "another point than the others: with speed_mm_per_s the rows have to be a way"
        if self.periods is not None and np.abs(points[-1] - points[0]).max() > SAME_M:
            x, y, z = (f"{round(value / M_PER_MM, 3):g}" for value in points[0])
            return f"the first row again, {x}, {y}, {z} mm: with periods the rows are repeated"
        return ""


class TipStep(MotionStep):
    """The tip follows a path in the rod-base frame. In `lead_in_s` it goes over smoothly from where it stands to the
    moving path. The set-points follow from the arm of the rig; a path that it cannot follow within `tolerance_mm` is
    refused.
    """

    moves_tip = True

    circle: Circle | SkipJsonSchema[None] = None
    figure_eight: FigureEight | SkipJsonSchema[None] = None
    star: Star | SkipJsonSchema[None] = None
    points: Points | SkipJsonSchema[None] = None
    hold: HeldPoint | SkipJsonSchema[None] = None
    csv: PathFile | SkipJsonSchema[None] = None
    lead_in_s: SecondsOrNone = Field(default=3.0, description="time of the way to the path")
    coordinates: Annotated[tuple[Coordinate, ...], Field(min_length=1, max_length=3)] = Field(
        default=AXES, description="coordinates that are controlled: at most as many as the rig has valves"
    )
    tolerance_mm: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False, strict=True)] = Field(
        default=0.5, description="largest distance of the model's tip from the path"
    )

    @model_validator(mode="after")
    def _check(self) -> TipStep:
        given = [name for name in SHAPES if getattr(self, name) is not None]
        found = []
        if not given:
            found.append(ValidationFault((), f"needs one of {', '.join(SHAPES)}"))
        elif given[1:]:
            found.append(ValidationFault((given[1],), f"one shape; write {' and '.join(given)} as separate steps"))
        twice = [axis for axis in AXES if self.coordinates.count(axis) > 1]
        if twice:
            found.append(ValidationFault(("coordinates",), f"each coordinate once; {twice[0]} is named twice"))
        faults(found)
        return self

    @property
    def shape(self) -> tuple[str, TipShape]:
        """The key of the shape, and the shape."""
        name = next(name for name in SHAPES if getattr(self, name) is not None)
        return name, getattr(self, name)

    def play(self, builder: TrajectoryBuilder) -> None:
        """The lead-in, if it takes time, and the path."""
        name, shape = self.shape
        builder.follow(
            self.label or name.replace("_", " "),
            shape.path(builder.data(self)),
            tuple(sorted(AXES.index(axis) for axis in self.coordinates)),
            self.lead_in_s,
            self.tolerance_mm * M_PER_MM,
        )

    def read(self, folder: Path) -> tuple[Any, dict[str, str]]:
        """Read the file of the shape, if it has one."""
        return self.shape[1].read(folder)

    @property
    def file_key(self) -> tuple[str, ...]:
        """The shape's key of its file."""
        return (self.shape[0], "file")

    @property
    def most_segments(self) -> tuple[int, tuple[str, ...]]:
        return 2, ()
