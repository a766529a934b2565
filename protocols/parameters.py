"""Parameters of a protocol: a name with a default, a unit and limits, used by its steps in place of numbers.

A step may compute a number from them. An expression is linear in the parameters: `peak_bar`, `peak_bar / 2`,
`low_bar + 4 * step_bar`, `peak_bar - 0.1`. So it has the unit of its parameters, and a comparison of names checks the
units. The arithmetic is decimal: the result is the number that a person would write.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationError, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.expectations import UNITS, unit_of
from protocols.steps.base import Number, StepPart
from protocols.validation import ValidationFault, faults

NAME = r"[A-Za-z][A-Za-z0-9_]*"
_NUMBER = r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)"
_TERM = rf"(?:{_NUMBER}|(?:{_NUMBER}\s*\*\s*)?{NAME}(?:\s*[*/]\s*{_NUMBER})?)"
PATTERN = rf"^\s*[+-]?\s*{_TERM}(?:\s*[+-]\s*{_TERM})*\s*$"
"""Regular expression of an expression, in the syntax that Python and JSON Schema share."""
LONGEST = 200

_EXPRESSION = re.compile(PATTERN)
_PART = re.compile(
    rf"(?P<sign>[+-]?)\s*(?:(?P<factor>{_NUMBER})\s*\*\s*)?(?:(?P<name>{NAME})|(?P<constant>{_NUMBER}))"
    rf"(?:\s*(?P<operator>[*/])\s*(?P<number>{_NUMBER}))?\s*"
)


def _known_unit(unit: str) -> str:
    if unit not in UNITS:
        raise ValueError(f"one of {', '.join(UNITS)}; leave it out for a plain number")
    return unit


Unit = Annotated[str, AfterValidator(_known_unit), Field(json_schema_extra={"enum": list(UNITS)})]


class ProtocolParameter(StepPart):
    """A number that the steps use by name, and that `rig run --set NAME=NUMBER` changes."""

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


@dataclass(frozen=True)
class Expression:
    """A sum of terms: a factor and the name of a parameter, or a constant and an empty name."""

    terms: tuple[tuple[Decimal, str], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters, in order, each once."""
        return tuple(dict.fromkeys(name for _, name in self.terms if name))

    def value(self, values: Mapping[str, float]) -> float:
        """The value for these values of the parameters."""
        return float(sum(f * (Decimal(repr(float(values[name]))) if name else 1) for f, name in self.terms))


def remedy(text: str) -> str:
    """What a text with the name of a parameter lacks to be an expression, in words."""
    if len(text) > LONGEST:
        return f"an expression of at most {LONGEST} characters"
    if _EXPRESSION.fullmatch(text):
        return "a number other than 0 after the /"
    return "a sum of parameters, each times or over a number, as in 2 * low_bar + peak_bar / 3 - 0.1"


def parsed(text: str) -> Expression | None:
    """The expression in a text that names at least one parameter; None if the text is none, or divides by 0."""
    if len(text) > LONGEST or not _EXPRESSION.fullmatch(text):
        return None
    terms = []
    for part in _PART.finditer(text.strip()):
        factor = Decimal(part["factor"] or part["constant"] or 1) * (-1 if part["sign"] == "-" else 1)
        number = Decimal(part["number"] or 1)
        if part["operator"] == "/" and not number:
            return None
        terms.append((factor / number if part["operator"] == "/" else factor * number, part["name"] or ""))
    expression = Expression(tuple(terms))
    return expression if expression.names else None
