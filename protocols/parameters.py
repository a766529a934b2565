"""Parameters of a protocol: a name with a default, a unit and limits, used by its steps in place of numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationError, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.expectations import UNITS, unit_of
from protocols.steps.base import Number, StepPart
from protocols.validation import ValidationFault, faults


def _known_unit(unit: str) -> str:
    if unit not in UNITS:
        raise ValueError(f"one of {', '.join(UNITS)}; leave it out for a plain number")
    return unit


Unit = Annotated[str, AfterValidator(_known_unit), Field(json_schema_extra={"enum": list(UNITS)})]


class ProtocolParameter(StepPart):
    """A number that the steps use by name, and that `rig run --set NAME=VALUE` changes."""

    default: Number = Field(description="the value where it is not set")
    unit: Unit | SkipJsonSchema[None] = Field(
        default=None, description="if left out, the unit that the name ends in, as in peak_bar; else a plain number"
    )
    lowest: Number | SkipJsonSchema[None] = Field(default=None, description="lowest value that it can be set to")
    highest: Number | SkipJsonSchema[None] = Field(default=None, description="highest value that it can be set to")
    description: str = ""

    @model_validator(mode="after")
    def _check(self) -> ProtocolParameter:
        if self.lowest is not None and self.highest is not None and self.lowest > self.highest:
            faults([ValidationFault(("highest",), f"a number of {self.lowest:.12g} or more, as `lowest` is")])
        if not self.admits(self.default):
            faults([ValidationFault(("default",), self.expected())])
        return self

    def admits(self, value: float) -> bool:
        """True for a value within the limits."""
        above = self.lowest is None or value >= self.lowest
        return above and (self.highest is None or value <= self.highest) and math.isfinite(value)

    def expected(self, unit: str = "") -> str:
        """What a value has to be, in words."""
        words = "a number"
        if self.lowest is not None and self.highest is not None:
            words += f" from {self.lowest:.12g} to {self.highest:.12g}"
        elif self.lowest is not None:
            words += f" of {self.lowest:.12g} or more"
        elif self.highest is not None:
            words += f" up to {self.highest:.12g}"
        return words + (f" ({unit})" if unit else "")


@dataclass(frozen=True)
class ParameterValue:
    """A parameter as an expansion uses it; `given` is False for its default."""

    name: str
    value: float
    unit: str
    given: bool

    def __str__(self) -> str:
        return f"{self.name} = {self.value:.12g}{f' {self.unit}' if self.unit else ''}"


def unit_in(name: str, declared: ProtocolParameter) -> str:
    """The unit of a parameter; an empty string for a plain number."""
    return declared.unit or unit_of(name)


def declared(data: Any) -> dict[str, ProtocolParameter | None]:
    """The parameters under the key `parameters`, by name; None for an invalid one."""
    return {name: _read(raw) for name, raw in data.items()} if isinstance(data, Mapping) else {}


def _read(raw: Any) -> ProtocolParameter | None:
    try:
        return ProtocolParameter.model_validate(raw)
    except ValidationError:
        return None
