"""Numbers of a protocol that are computed from its parameters.

An expression is linear in the parameters: `peak_bar`, `peak_bar / 2`, `low_bar + 4 * step_bar`, `peak_bar - 0.1`. So it
has the unit of its parameters, and a comparison of names checks the units. The arithmetic is decimal: the result is the
number that a person would write.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal

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
