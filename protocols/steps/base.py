"""Base classes of protocol steps: validated values, and the methods that turn a step into segments.

Levels are gauge pressures in bar, times in seconds. A number that may differ between actuators is either one number
for all of them or a list with one number for each, in the order of `actuators`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.trajectory_builder import TrajectoryBuilder
from protocols.validation import ValidationFault, faults

MOST_SEGMENTS = 20_000
LONGEST_S = 1e6
LOWEST_BAR, HIGHEST_BAR = -1.0, 100.0


def _list_or_number(value: Any) -> str:
    return "each" if isinstance(value, list | tuple) else "all"


Bar = Annotated[float, Field(ge=LOWEST_BAR, le=HIGHEST_BAR, allow_inf_nan=False, strict=True)]
BarOrZero = Annotated[float, Field(ge=0, le=HIGHEST_BAR, allow_inf_nan=False, strict=True)]
BarAbove = Annotated[float, Field(gt=0, le=HIGHEST_BAR, allow_inf_nan=False, strict=True)]
Grams = Annotated[float, Field(ge=0, le=1e5, allow_inf_nan=False, strict=True)]
Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0, le=LONGEST_S, allow_inf_nan=False, strict=True)]
Seconds = Annotated[float, Field(gt=0, le=LONGEST_S, allow_inf_nan=False, strict=True)]
SecondsOrNone = Annotated[float, Field(ge=0, le=LONGEST_S, allow_inf_nan=False, strict=True)]
Actuator = Annotated[int, Field(ge=1, le=64, strict=True)]
Actuators = Annotated[tuple[Actuator, ...], Field(min_length=1, description="numbers of the actuators it drives")]
Text = Annotated[str, Field(min_length=1)]

Value = TypeVar("Value")
OneOrEach = Annotated[
    Annotated[Value, Tag("all")] | Annotated[tuple[Value, ...], Tag("each")], Discriminator(_list_or_number)
]
BarEach = OneOrEach[Bar]
AmplitudeEach = OneOrEach[BarOrZero]
NumberEach = OneOrEach[Number]
PositiveEach = OneOrEach[Positive]


class StepPart(BaseModel):
    """A mapping of the YAML: unknown keys are errors, nothing is coerced."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class LeafStep(StepPart, ABC):
    """A step that takes time. `protocols.schema.Step` registers the kinds.

    moves_tip: the step gives a path of the tip, from which the set-points follow.
    """

    moves_tip: ClassVar[bool] = False

    @abstractmethod
    def play(self, builder: TrajectoryBuilder) -> None:
        """Append the segments of the step."""

    @property
    def most_segments(self) -> tuple[int, tuple[str, ...]]:
        """Upper bound of the number of segments, and the path of the value that determines it."""
        return 1, ()

    @property
    def file_key(self) -> tuple[str, ...]:
        """The path of the value that names the step's file."""
        return ("file",)

    def read(self, folder: Path) -> tuple[Any, dict[str, str]]:
        """Read the files that the step names, relative to the protocol's folder: their content, and texts by name.

        Raises:
            BadInputError: a file cannot be used.
        """
        return None, {}


class MotionStep(LeafStep, ABC):
    """A step that moves or holds pressures."""

    label: Text | SkipJsonSchema[None] = Field(default=None, description="its name in reports")


class PressureStep(MotionStep, ABC):
    """A step of some actuators: what it lists beside them has one number for each."""

    actuators: Actuators

    @model_validator(mode="after")
    def _check(self) -> Self:
        faults(self.faults())
        return self

    def faults(self) -> list[ValidationFault]:
        """What is wrong with the values of the step together."""
        return fits(self.actuators, {name: value for name, value in self if name != "actuators"})


def each(value: float | tuple[float, ...], count: int) -> tuple[float, ...]:
    """One value per actuator, from one for all or one for each."""
    return value if isinstance(value, tuple) else (value,) * count


def fits(actuators: Sequence[int], values: dict[str, Any]) -> list[ValidationFault]:
    found = []
    twice = sorted({number for number in actuators if list(actuators).count(number) > 1})
    if twice:
        found.append(ValidationFault(("actuators",), f"each actuator once; {twice[0]} is named twice"))
    for name, value in values.items():
        if isinstance(value, tuple) and len(value) != len(actuators):
            found.append(
                ValidationFault(
                    (name,), f"one number, or one for each of the {len(actuators)} actuators, not {len(value)}"
                )
            )
    return found


def one_of(names: Sequence[str], given: Sequence[object]) -> list[ValidationFault]:
    """The fault of keys of which not exactly one is given."""
    present = [name for name, value in zip(names, given, strict=True) if value is not None]
    if len(present) == 1:
        return []
    if not present:
        return [ValidationFault((), f"needs {' or '.join(names)}")]
    return [ValidationFault((present[-1],), f"{' or '.join(names)}, not both")]


def levels_text(bar: float | tuple[float, ...]) -> str:
    """Levels as a label: '0.1 / 0.2 bar'."""
    values = bar if isinstance(bar, tuple) else (bar,)
    return " / ".join(f"{value:g}" for value in values) + " bar"
