"""A path of the tip."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.steps.base import MotionStep, SecondsOrNone, TrajectoryBuilder
from protocols.steps.tip_shapes import M_PER_MM, Circle, FigureEight, HeldPoint, PathFile, Points, Star, TipShape
from protocols.validation import ValidationFault, faults

Coordinate = Literal["x", "y", "z"]
AXES: tuple[Coordinate, ...] = ("x", "y", "z")
SHAPES = ("circle", "figure_eight", "star", "points", "hold", "csv")


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
