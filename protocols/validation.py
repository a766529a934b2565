"""Validates a document by a pydantic model; every problem has its line and column."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from protocols.expectations import Expectation, Schema, factor_to, in_bounds, unit_of, wants_number
from protocols.problems import BadInputError, Problem, closest
from protocols.source_positions import Document, SourcePosition, path_text, shortened

Model = TypeVar("Model", bound=BaseModel)
NESTED = "nested"


@dataclass(frozen=True)
class ValidationFault:
    """A fault found by a model's own check: the path from the model to the value, and the remedy."""

    path: tuple[str | int, ...]
    expected: str
    suggestion: str = ""


def faults(found: Iterable[ValidationFault]) -> None:
    """Raise all faults from inside a pydantic validator; do nothing if there are none."""
    listed = tuple(found)
    if listed:
        text = "; ".join(f"{path_text(fault.path)}: {fault.expected}" for fault in listed)
        raise PydanticCustomError("faults", "{text}", {"text": text, "faults": listed})


def nested_faults(error: ValidationError, model_class: type[BaseModel]) -> PydanticCustomError:
    """The error of a validator that has chosen `model_class` for its value: `validate` reports what is inside it."""
    inside = error.errors(include_url=False)
    return PydanticCustomError(
        NESTED, "{text}", {"text": str(error), "errors": inside, "schema": json_schema(model_class)}
    )


def _flattened(
    errors: Iterable[ErrorDetails], schemas: dict[tuple[str | int, ...], Any], here: tuple[str | int, ...] = ()
) -> Iterator[ErrorDetails]:
    """The errors, those of nested models at their paths; adds the schemas of these models by path."""
    for error in errors:
        path = (*here, *error["loc"])
        if error["type"] == NESTED:
            schemas[path] = error["ctx"]["schema"]
            yield from _flattened(error["ctx"]["errors"], schemas, path)
        else:
            yield {**error, "loc": path}


def validate(
    model_class: type[Model],
    document: Document,
    partial: Callable[[Mapping[str, Any]], Iterable[ValidationFault]] | None = None,
    context: Mapping[str, Any] | None = None,
) -> Model:
    """The model of the document, or `BadInputError` with all problems.

    If some fields are invalid, `partial` checks the relations between the valid ones; it gets only those. Validators
    of the model get `context`. A mapping with a value that could not be read is not judged as a whole.
    """
    problems = list(document.problems)
    model = None
    try:
        model = model_class.model_validate(document.data, context=dict(context or {}))
    except ValidationError as error:
        _refuse_other_kind(model_class, document)
        schemas: dict[tuple[str | int, ...], Any] = {}
        errors = list(_flattened(error.errors(include_url=False), schemas))
        translator = _Translator(document, Expectation(json_schema(model_class), schemas))
        found = translator.problems(errors)
        if partial is not None and "faults" not in {e["type"] for e in errors if not e["loc"]}:
            found += [translator.fault((), fault) for fault in partial(_valid_parts(model_class, document.data))]
        own = {(problem.line, problem.column) for problem in found if problem.file == document.file}
        replaced = own & document.replaceable
        problems = [problem for problem in problems if (problem.line, problem.column) not in replaced]
        unread = {problem.where for problem in problems}
        found = [p for p in found if p.value or not any(where.startswith(f"{p.where}, ") for where in unread)]
        known = {problem.place for problem in problems}
        problems += [problem for problem in found if problem.place not in known]
    if problems or model is None:
        raise BadInputError(sorted(_once(problems), key=lambda one: (one.file != document.file, *one.place)))
    return model


@cache
def json_schema(model_class: type[BaseModel]) -> dict[str, Any]:
    """The JSON schema of a model, cached because it takes 10 ms; read only."""
    return model_class.model_json_schema()


def _refuse_other_kind(model_class: type[BaseModel], document: Document) -> None:
    """Raise `BadInputError` with one problem if the file has none of the required keys."""
    needed = [name for name, field in model_class.model_fields.items() if field.is_required()]
    if document.data and not any(closest(key, needed) for key in document.data):
        expected = f"{', '.join(needed)}: is this another kind of file?"
        raise BadInputError([Problem(document.file, 1, 1, "", shortened(", ".join(document.data)), expected)])


def _once(problems: Iterable[Problem]) -> list[Problem]:
    """The problems without repetitions by an alias (*name)."""
    kept: dict[object, Problem] = {}
    for problem in problems:
        place = (problem.place, problem.expected, problem.value)
        kept.setdefault(place if problem.value else problem, problem)
    return list(kept.values())


def _valid_parts(model_class: type[BaseModel], data: Mapping[str, Any]) -> dict[str, Any]:
    """The valid fields; invalid items of lists and mappings are None."""
    parts = {}
    for name, field in model_class.model_fields.items():
        if name not in data and not field.is_required():
            parts[name] = field.get_default(call_default_factory=True)
        elif name in data:
            whole = _valid(field.rebuild_annotation(), data[name])
            kind, items = get_origin(field.annotation), get_args(field.annotation)
            if whole is not None:
                parts[name] = whole
            elif kind is tuple and isinstance(data[name], list):
                parts[name] = tuple(_valid(items[0], item) for item in data[name])
            elif kind is dict and isinstance(data[name], dict):
                parts[name] = {key: _valid(items[1], item) for key, item in data[name].items()}
    return parts


def _valid(annotation: Any, value: Any) -> Any:
    try:
        return TypeAdapter(annotation).validate_python(value)
    except ValidationError:
        return None


class _Translator:
    """Translates errors of pydantic to problems with a source position."""

    def __init__(self, document: Document, expectation: Expectation) -> None:
        self._document = document
        self._expectation = expectation

    def problems(self, errors: Iterable[ErrorDetails]) -> list[Problem]:
        listed = [error for error in errors if not self._is_echo(error)]
        unknown = {self._path(e["loc"]) for e in listed if e["type"] == "extra_forbidden"}
        intended = {(*path[:-1], self._closest_key(path)) for path in unknown}
        problems: list[Problem] = []
        for error in listed:
            path = self._path(error["loc"])
            if error["type"] == "missing" and path in intended:
                continue
            made = self._several(error, path)
            problems += [problem for problem in made if problem not in problems]
        return problems

    def _is_echo(self, error: ErrorDetails) -> bool:
        """True for secondary errors of pydantic: a list too short by its invalid items, and the None of an optional."""
        if error["type"] == "too_short":
            value = self._value(self._path(error["loc"]))
            return hasattr(value, "__len__") and len(value) >= error["ctx"]["min_length"]
        return error["type"] == "none_required"

    def fault(self, base: tuple[str | int, ...], fault: ValidationFault) -> Problem:
        """The problem of a fault inside the value at `base`."""
        path = (*base, *fault.path)
        if not fault.path or not self._exists(path):
            return self._document.problem(path, fault.expected, "", fault.suggestion, at_key=True)
        found = shortened(self._document.position(path).source)
        return self._document.problem(path, fault.expected, found, fault.suggestion)

    def _several(self, error: ErrorDetails, path: tuple[str | int, ...]) -> list[Problem]:
        kind = error["type"]
        if kind == "faults":
            return [self.fault(path, fault) for fault in error["ctx"]["faults"]]
        if kind == "missing" and isinstance(error["loc"][-1], str):
            return [self._missing(path)]
        if kind == "extra_forbidden":
            return [self._unknown(path)]
        position = self._document.position(path)
        if kind in {"union_tag_not_found", "union_tag_invalid"} and isinstance(self._value(path), dict):
            tag = str(error["ctx"]["discriminator"]).strip("'")
            here = (*path, tag)
            if kind == "union_tag_not_found":
                return [self._missing(here)]
            position, path = self._document.position(here), here
        if kind in {"value_error", "assertion_error"}:
            expected = str(error["ctx"]["error"])
        else:
            expected = self._expectation.words(path, self._document.data)
        suggestion = self._suggestion(path, position)
        if suggestion and isinstance(value := self._value(path), str) and _measure(value, unit := unit_of(_key(path))):
            expected = f"a number in {unit}, without its unit"
        if position.hint:
            expected += f"; {position.hint}"
        found = shortened(position.source) or "nothing"
        return [self._document.problem(path, expected, found, suggestion)]

    def _missing(self, path: tuple[str | int, ...]) -> Problem:
        expected = f"is missing: {self._expectation.words(path, self._document.data)}"
        return self._document.problem(path, expected, "", at_key=True)

    def _unknown(self, path: tuple[str | int, ...]) -> Problem:
        known = self._expectation.keys(path[:-1], self._document.data)
        expected = f"one of {', '.join(known)}" if known else "no such key"
        found = shortened(f"the unknown key '{path[-1]}'")
        return self._document.problem(path, expected, found, self._closest_key(path), at_key=True)

    def _closest_key(self, path: tuple[str | int, ...]) -> str:
        known = self._expectation.keys(path[:-1], self._document.data)
        absent = [key for key in known if not self._exists((*path[:-1], key))]
        return closest(str(path[-1]), absent) or closest(str(path[-1]), known)

    def _suggestion(self, path: tuple[str | int, ...], position: SourcePosition) -> str:
        """A corrected value that fits the schema."""
        schema = self._schema(path)
        value = self._value(path)
        wanted = schema.get("type")
        lists_numbers = wanted == "array" and wants_number(schema.get("items", {}))
        if position.hint and wanted in {"string", "boolean"}:
            return f"'{position.source}'" if wanted == "string" else position.hint.rsplit(" ", 1)[-1]
        if isinstance(value, str):
            if "enum" in schema or "const" in schema:
                return closest(value, [str(word) for word in schema.get("enum", [schema.get("const")])])
            return (
                _corrected_number(value, unit_of(_key(path)), schema, position.quoted) if wants_number(schema) else ""
            )
        if isinstance(value, float) and wanted == "integer" and value.is_integer():
            return str(int(value))
        if isinstance(value, int | float):
            return f"'{position.source}'" if wanted == "string" else f"[{position.source}]" if lists_numbers else ""
        if isinstance(value, dict) and lists_numbers and value and all(key.isdigit() for key in value):
            return f"[{', '.join(value)}]"
        return ""

    def _schema(self, path: tuple[str | int, ...]) -> Schema:
        """The schema of the number or of the first item of the list at a path, else of the value there."""
        schema = self._expectation.at(path, self._document.data)
        branches = schema.get("anyOf") or schema.get("oneOf") or ()
        numbers = [branch for branch in branches if branch.get("type") in {"number", "integer"}]
        return {**schema, **numbers[0]} if numbers else schema

    def _path(self, loc: tuple[str | int, ...]) -> tuple[str | int, ...]:
        """pydantic's location without the tags of unions; a missing key may be its last element."""
        path: list[str | int] = []
        parent = self._document.positions
        for position, step in enumerate(loc):
            if step in parent.children:
                path.append(step)
                parent = parent.children[step]
            elif position == len(loc) - 1 and step in self._expectation.keys(tuple(path), self._document.data):
                path.append(step)
        return tuple(path)

    def _exists(self, path: tuple[str | int, ...]) -> bool:
        position = self._document.positions
        for step in path:
            if step not in position.children:
                return False
            position = position.children[step]
        return True

    def _value(self, path: tuple[str | int, ...]) -> Any:
        data: Any = self._document.data
        for step in path:
            if isinstance(data, dict):
                data = data.get(str(step))
            elif isinstance(data, list) and isinstance(step, int) and step < len(data):
                data = data[step]
            else:
                return None
        return data


def _key(path: tuple[str | int, ...]) -> str:
    """The last key of a path."""
    return next((step for step in reversed(path) if isinstance(step, str)), "")


_MEASURE = re.compile(r"\s*([-+]?\d*[.,]?\d+(?:[eE][-+]?\d{1,2})?)\s*([^\s\d]*)\s*")


def _measure(text: str, unit: str) -> tuple[Decimal, float] | None:
    """The number of a text such as '50 kPa', and its factor to `unit`; None for any other text."""
    match = _MEASURE.fullmatch(text)
    if match is None or not match[2] or (factor := factor_to(unit, match[2])) is None:
        return None
    return Decimal(match[1].replace(",", ".")), factor


def _corrected_number(text: str, unit: str, schema: Schema, quoted: bool) -> str:
    """The number in a text such as '0.15', '0,15' or '50 kPa', in `unit`; empty if there is none, or not in bounds."""
    match = _MEASURE.fullmatch(text)
    if match is None:
        return ""
    number, factor = _measure(text, unit) or (Decimal(match[1].replace(",", ".")), 0.0 if match[2] else 1.0)
    if not factor or not in_bounds(schema, float(number) * factor):
        return ""
    written = f"{number:f}" if factor == 1.0 else f"{float(number) * factor:.6g}"
    return f"{written}, without quotes" if quoted and not match[2] else written
