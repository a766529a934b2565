"""Replaces the names of parameters in the steps of a protocol by their values, before the steps are validated."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import yaml
from yaml.resolver import Resolver

from protocols.expectations import Expectation, Schema, unit_of, wants_number
from protocols.parameters import NAME, Expression, ParameterValue, ProtocolParameter, declared, parsed, remedy, unit_in
from protocols.problems import Problem, closest
from protocols.source_positions import Document, SourcePosition, shortened

Path = tuple[str | int, ...]
KEY = "parameters"


@dataclass(frozen=True)
class Substitution:
    """A document whose steps have numbers in place of names, and the values used.

    `unresolved` are the line and column of each use of a parameter whose declaration is invalid.
    """

    document: Document
    values: tuple[ParameterValue, ...] = ()
    unresolved: frozenset[tuple[int, int]] = frozenset()


def substitute(document: Document, schema: Schema, settings: Mapping[str, float]) -> Substitution:
    """Replace the parameters by their defaults, or by the values in `settings`; `schema` is that of protocols.

    Every problem of declarations, settings and uses is added to the problems of the document.
    """
    substituter = _Substituter(document, schema, settings)
    steps, positions = substituter.replaced(document.data.get("steps"), document.position(("steps",)), ("steps",))
    root = document.positions
    if "steps" in document.data:
        root = replace(root, children=root.children | {"steps": positions})
        document = replace(document, data=document.data | {"steps": steps}, positions=root)
    problems = (*document.problems, *substituter.problems, *substituter.unused())
    values = tuple(substituter.values.values())
    return Substitution(replace(document, problems=problems), values, frozenset(substituter.unresolved))


class _Substituter:
    def __init__(self, document: Document, schema: Schema, settings: Mapping[str, float]) -> None:
        self.problems: list[Problem] = []
        self.unresolved: set[tuple[int, int]] = set()
        self.values: dict[str, ParameterValue] = {}
        self._document = document
        self._expectation = Expectation(schema)
        self._declared = declared(document.data.get(KEY))
        self._used: set[str] = set()
        reserved = _reserved(schema)
        for name, parameter in self._declared.items():
            self._check_name(name, parameter, reserved)
            if parameter is not None:
                self._set(name, parameter, settings)
        for name in sorted(set(settings) - set(self._declared)):
            known = ", ".join(self._declared)
            expected = (
                f"one of the protocol's parameters: {known}" if known else "no such value: there are no parameters"
            )
            found = f"{name} = {settings[name]:.12g}, as set"
            self._add_at_key((KEY,), found, expected, closest(name, self._declared))

    def replaced(self, data: Any, position: SourcePosition, path: Path) -> tuple[Any, SourcePosition]:
        """The data with numbers in place of names, and its positions, whose source shows both."""
        if isinstance(data, dict | list):
            items = data.items() if isinstance(data, dict) else enumerate(data)
            made = {key: self.replaced(item, position.children[key], (*path, key)) for key, item in items}
            positions = replace(position, children={key: below for key, (_, below) in made.items()})
            values = {key: value for key, (value, _) in made.items()}
            return (values if isinstance(data, dict) else list(values.values())), positions
        place = self._expectation.at(path, self._document.data) if isinstance(data, str) else {}
        if not wants_number(place):
            return data, position
        if position.quoted or (expression := parsed(data)) is None:
            self._check_remedy(data, position, path)
            return data, position
        self._used.update(expression.names)
        if not self._usable(expression, position, path):
            return data, position
        value: float | int = expression.value({name: self.values[name].value for name in expression.names})
        source = f"{position.source} = {value:.12g}"
        if place.get("type") == "integer" and float(value).is_integer():
            value = int(value)
        return value, replace(position, source=source)

    def unused(self) -> Iterator[Problem]:
        """A problem for each parameter that no step uses."""
        for name, parameter in self._declared.items():
            if parameter is not None and name not in self._used:
                expected = "a parameter that a step uses; none uses this one"
                yield self._document.problem((KEY, name), expected, shortened(name), at_key=True)

    def _set(self, name: str, parameter: ProtocolParameter, settings: Mapping[str, float]) -> None:
        value, unit = settings.get(name, parameter.default), unit_in(name, parameter)
        if not parameter.admits(value):
            self._add_at_key((KEY, name), f"{name} = {value:.12g}, as set", parameter.expected(unit))
            value = parameter.default
        self.values[name] = ParameterValue(name, float(value), unit, name in settings)

    def _check_name(self, name: str, parameter: ProtocolParameter | None, reserved: frozenset[str]) -> None:
        path, ending = (KEY, name), unit_of(name)
        tag = Resolver().resolve(yaml.ScalarNode, name, (True, False))  # type: ignore[no-untyped-call]
        if not re.fullmatch(NAME, name) or not tag.endswith(":str"):
            words = "a name of letters, digits and _ that begins with a letter and that YAML does not read as a value"
            self._add_at_key(path, name, words)
        elif name in reserved:
            self._add_at_key(path, name, "another name: this is a key of protocols")
        elif parameter is not None and parameter.unit is not None and ending not in ("", parameter.unit):
            self._add((*path, "unit"), f"{ending}, in which the name {name} ends, or another name")

    def _check_remedy(self, text: str, position: SourcePosition, path: Path) -> None:
        """Say what a text with the name of a parameter lacks to be an expression."""
        if names := set(re.findall(NAME, text)) & set(self._declared):
            self._used |= names
            words = "this text without quotes" if position.quoted and parsed(text) else remedy(text)
            self._add(path, f"{self._expectation.words(path, self._document.data)}, or {words}")

    def _usable(self, expression: Expression, position: SourcePosition, path: Path) -> bool:
        """True if every name is a valid parameter in the unit of the place."""
        field = next(step for step in reversed(path) if isinstance(step, str))
        unit, usable = unit_of(field), True
        for name in expression.names:
            if name not in self._declared:
                fitting = [n for n, value in self.values.items() if value.unit == unit]
                known = f", or a parameter in {unit}" if unit else ", or a parameter without a unit"
                known += f": {', '.join(fitting)}" if fitting else ", of which there is none"
                expected = self._expectation.words(path, self._document.data) + known
                self._add(path, expected, closest(name, self._declared))
            elif (value := self.values.get(name)) is None:
                self.unresolved.add((position.line, position.column))
            elif value.unit != unit:
                wanted = f"a parameter in {unit}" if unit else "a parameter without a unit"
                has = f"is in {value.unit}" if value.unit else "has no unit"
                self._add(path, f"{wanted}; {name} {has}")
            else:
                continue
            usable = False
        return usable

    def _add(self, path: Path, expected: str, suggestion: str = "") -> None:
        """Add the problem of the value at a path of the document."""
        found = shortened(self._document.position(path).source)
        self.problems.append(self._document.problem(path, expected, found, suggestion))

    def _add_at_key(self, path: Path, value: str, expected: str, suggestion: str = "") -> None:
        self.problems.append(self._document.problem(path, expected, shortened(value), suggestion, at_key=True))


def _reserved(schema: Schema) -> frozenset[str]:
    """The keys of protocols that are no numbers."""
    parts = (schema, *schema["$defs"].values())
    keys = ((key, inner) for part in parts for key, inner in part.get("properties", {}).items())
    return frozenset(key for key, inner in keys if not wants_number(inner))
