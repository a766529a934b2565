"""A YAML file read and held against a pydantic model, with every fault placed at its line and column."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from protocols.describe import Expectation
from protocols.marks import Document, Mark, Reader, TooDeep, compose, path_text, shortened
from protocols.problems import BadInput, Problem, closest

__all__ = ["Document", "Fault", "faults", "parse", "read", "read_text", "validate"]

LARGEST_FILE = 200_000

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Fault:
    """What a model's own check finds wrong: the path from the model to the value, and the remedy."""

    path: tuple[str | int, ...]
    expected: str
    suggestion: str = ""


def faults(found: Iterable[Fault]) -> None:
    """Raise, from inside a pydantic validator, all that was found; do nothing when nothing was."""
    listed = tuple(found)
    if listed:
        text = "; ".join(f"{path_text(fault.path)}: {fault.expected}" for fault in listed)
        raise PydanticCustomError("faults", "{text}", {"text": text, "faults": listed})


def read(path: Path) -> Document:
    """The document in a file. Raises `BadInput` when it is no YAML mapping at all; lesser faults stay in it."""
    return parse(read_text(path, LARGEST_FILE), str(path))


def read_text(path: Path, largest: int) -> str:
    """The text of a UTF-8 file of at most `largest` bytes, or `BadInput`."""

    def bad(expected: str, line: int = 0, column: int = 0, value: str = "") -> BadInput:
        return BadInput([Problem(str(path), line, column, "", value, expected)])

    try:
        if path.is_dir():
            raise bad("this is a folder, not a file")
        if path.exists() and not path.is_file():
            raise bad("this is not a regular file")
        if path.stat().st_size > largest:
            raise bad(f"the file is too large: at most {largest // 1000} kB")
        raw = path.read_bytes()
    except FileNotFoundError:
        raise bad("there is no such file") from None
    except (OSError, ValueError) as error:
        raise bad(f"the file cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise bad("the file is UTF-16; save it as UTF-8")
    try:
        return raw.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line = before.count(b"\n") + 1
        column = len(before[before.rfind(b"\n") + 1 :].decode("utf-8", "replace")) + 1
        raise bad(
            "UTF-8 text; save the file with that encoding", line, column, f"byte 0x{raw[error.start]:02x}"
        ) from None


def parse(text: str, file: str) -> Document:
    """The document in `text`; `file` is the name that its problems carry."""
    try:
        node = compose(text)
    except yaml.YAMLError as error:
        raise BadInput([_syntax_problem(error, text, file)]) from None
    except RecursionError:
        raise BadInput([Problem(file, 0, 0, "", "", "the file is nested too deeply")]) from None
    if node is None or (isinstance(node, yaml.ScalarNode) and not node.value and node.style is None):
        raise BadInput([Problem(file, 0, 0, "", "", "the file is empty")])
    reader = Reader(file, text)
    data, marks = reader.value(node, ())
    if reader.too_large:
        expected = "a smaller file: with its aliases (*name) spelt out it has too many values"
        raise BadInput([Problem(file, 0, 0, "", "", expected)])
    if not isinstance(data, dict):
        kind = "a list" if isinstance(data, list) else shortened(marks.source)
        expected = "a mapping ('key: value' lines) at the top of the file"
        raise BadInput([Problem(file, marks.line, marks.column, "", kind, expected)])
    return Document(file, text, data, marks, tuple(reader.problems))


def validate(
    model_class: type[Model],
    document: Document,
    partial: Callable[[Mapping[str, Any]], Iterable[Fault]] | None = None,
) -> Model:
    """The model that the document describes, or `BadInput` with everything that is wrong with it.

    `partial` finds faults between the fields that are valid by themselves when others are not; it gets those only.
    """
    problems = list(document.problems)
    model = None
    try:
        model = model_class.model_validate(document.data)
    except ValidationError as error:
        schema = model_class.model_json_schema()
        translator = _Translator(document, Expectation(schema))
        found = translator.problems(error.errors(include_url=False))
        if partial is not None and "faults" not in {e["type"] for e in error.errors() if not e["loc"]}:
            found += [translator.fault((), fault) for fault in partial(_valid_parts(model_class, document.data))]
        written = {(problem.line, problem.column) for problem in problems}
        problems += [problem for problem in found if (problem.line, problem.column) not in written]
    if problems or model is None:
        raise BadInput(sorted(problems, key=lambda problem: (problem.line, problem.column)))
    return model


def _valid_parts(model_class: type[BaseModel], data: Mapping[str, Any]) -> dict[str, Any]:
    parts = {}
    for name, field in model_class.model_fields.items():
        if name not in data and not field.is_required():
            parts[name] = field.get_default(call_default_factory=True)
        elif name in data:
            try:
                parts[name] = TypeAdapter(field.rebuild_annotation()).validate_python(data[name])
            except ValidationError:
                continue
    return parts


class _Translator:
    """From pydantic's errors to problems with a place in the file."""

    def __init__(self, document: Document, expectation: Expectation) -> None:
        self._document = document
        self._expectation = expectation

    def problems(self, errors: Iterable[ErrorDetails]) -> list[Problem]:
        listed = list(errors)
        unknown = {self._path(e["loc"]) for e in listed if e["type"] == "extra_forbidden"}
        meant = {(*path[:-1], self._meant(path)) for path in unknown}
        problems: list[Problem] = []
        for error in listed:
            path = self._path(error["loc"])
            if error["type"] == "missing" and path in meant:
                continue
            made = self._several(error, path)
            problems += [problem for problem in made if problem not in problems]
        return problems

    def fault(self, base: tuple[str | int, ...], fault: Fault) -> Problem:
        path = (*base, *fault.path)
        mark = self._document.mark(path)
        value = mark.source if path == () or self._exists(path) else ""
        if not base and not fault.path:
            value = ""
        return self._problem(mark, path, value, fault.expected, fault.suggestion)

    def _several(self, error: ErrorDetails, path: tuple[str | int, ...]) -> list[Problem]:
        kind = error["type"]
        if kind == "faults":
            return [self.fault(path, fault) for fault in error["ctx"]["faults"]]
        if kind == "missing":
            return [self._missing(path)]
        if kind == "extra_forbidden":
            return [self._unknown(path)]
        mark = self._document.mark(path)
        if kind in {"union_tag_not_found", "union_tag_invalid"} and isinstance(self._value(path), dict):
            tag = str(error["ctx"]["discriminator"]).strip("'")
            here = (*path, tag)
            if kind == "union_tag_not_found":
                return [self._missing(here)]
            mark, path = self._document.mark(here), here
        if kind in {"value_error", "assertion_error"}:
            expected = str(error["ctx"]["error"])
        else:
            expected = self._expectation.words(path, self._document.data)
        return [self._problem(mark, path, mark.source, expected, self._suggestion(path, mark))]

    def _missing(self, path: tuple[str | int, ...]) -> Problem:
        parent = self._document.mark(path[:-1])
        line, column = (parent.key_line, parent.key_column) if parent.key_line else (parent.line, parent.column)
        expected = f"is missing: {self._expectation.words(path, self._document.data)}"
        return self._problem(replace(parent, line=line, column=column), path, "", expected, "")

    def _unknown(self, path: tuple[str | int, ...]) -> Problem:
        mark = self._document.mark(path)
        known = self._expectation.keys(path[:-1], self._document.data)
        here = replace(mark, line=mark.key_line, column=mark.key_column)
        expected = f"one of {', '.join(known)}" if known else "no such key"
        return self._problem(here, path, f"the unknown key '{path[-1]}'", expected, self._meant(path))

    def _meant(self, path: tuple[str | int, ...]) -> str:
        return closest(str(path[-1]), self._expectation.keys(path[:-1], self._document.data))

    def _suggestion(self, path: tuple[str | int, ...], mark: Mark) -> str:
        """A repair of the value that fits what the place expects."""
        schema = self._expectation.at(path, self._document.data)
        value = self._value(path)
        if isinstance(value, str):
            if "enum" in schema or "const" in schema:
                return closest(value, [str(word) for word in schema.get("enum", [schema.get("const")])])
            return _number_meant(value, mark) if _wants(schema, ("number", "integer")) else ""
        if isinstance(value, float) and schema.get("type") == "integer" and value.is_integer():
            return str(int(value))
        if isinstance(value, int | float):
            if schema.get("type") == "string":
                return f"'{mark.source}'"
            if schema.get("type") == "array":
                return f"[{mark.source}]"
        return ""

    def _path(self, loc: tuple[str | int, ...]) -> tuple[str | int, ...]:
        """pydantic's location without the tags of unions; a missing key may be its last element."""
        path: list[str | int] = []
        mark = self._document.marks
        for position, step in enumerate(loc):
            if step in mark.children:
                path.append(step)
                mark = mark.children[step]
            elif position == len(loc) - 1 and step in self._expectation.keys(tuple(path), self._document.data):
                path.append(step)
        return tuple(path)

    def _exists(self, path: tuple[str | int, ...]) -> bool:
        mark = self._document.marks
        for step in path:
            if step not in mark.children:
                return False
            mark = mark.children[step]
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

    def _problem(self, mark: Mark, path: tuple[str | int, ...], value: str, expected: str, suggestion: str) -> Problem:
        return Problem(
            self._document.file, mark.line, mark.column, path_text(path), shortened(value), expected, suggestion
        )


def _wants(schema: Mapping[str, Any], kinds: tuple[str, ...]) -> bool:
    return schema.get("type") in kinds or any(
        branch.get("type") in kinds for branch in schema.get("anyOf") or schema.get("oneOf") or ()
    )


def _number_meant(text: str, mark: Mark) -> str:
    """The number inside a text such as '4 s', '0,15' or 1e5."""
    match = re.match(r"\s*([-+]?\d*[.,]?\d+([eE][-+]?\d+)?)", text)
    if not match:
        return ""
    number = match.group(1).replace(",", ".")
    if "e" in number.lower():
        value = float(number)
        return (
            f"{value:.0f}" if abs(value) < 1e15 and value == int(value) else f"{value!r}" if "." in repr(value) else ""
        )
    return f"{number}, without quotes" if mark.quoted and number == text.strip() else number


_SYNTAX = (
    ("cannot start any token", "no tab here: YAML indents with spaces", "\t"),
    ("mapping values are not allowed here",
     "no second ':' in this line: indent this line like its neighbours, and put text that contains ': ' in quotes", ""),
    ("could not find expected ':'", "a ':' after the key in this line or the one before", ""),
    ("expected <block end>", "this line indented like the lines that it belongs with", ""),
    ("expected ',' or '}'", "a ',' or the closing '}' here", ""),
    ("expected ',' or ']'", "a ',' or the closing ']' here", ""),
    ("found undefined alias", "an anchor (&name) above for this alias (*name)", ""),
    ("but found another document", "one document: no second '---' line", ""),
    ("found unexpected end of stream", "the closing quote of the text that begins here", ""),
    ("cannot start any token", "quotes around text that begins with this character", ""),
    ("found duplicate anchor", "each anchor (&name) once", ""),
    ("could not determine a constructor", "a plain value without a tag", ""),
)  # fmt: skip


def _syntax_problem(error: yaml.YAMLError, text: str, file: str) -> Problem:
    """One plain sentence for what PyYAML says about the text."""
    if isinstance(error, TooDeep):
        mark = error.problem_mark
        return Problem(file, mark.line + 1 if mark else 0, 0, "", "", "the file is nested too deeply")
    if isinstance(error, yaml.reader.ReaderError):
        line = text.count("\n", 0, error.position) + 1
        column = error.position - (text.rfind("\n", 0, error.position) + 1) + 1
        found = f"the control character U+{int(error.character):04X}"
        return Problem(file, line, column, "", found, "text without control characters: is this a YAML file?")
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return Problem(file, 0, 0, "", "", f"YAML cannot read this: {error}")
    said = error.problem or error.context or ""
    mark = error.problem_mark
    if "unexpected end of stream" in said and error.context_mark is not None:
        mark = error.context_mark
    rows = text.split("\n")
    row = rows[mark.line] if mark.line < len(rows) else ""
    character = row[mark.column : mark.column + 1]
    expected = next(
        (words for key, words, only in _SYNTAX if key in said and (not only or character == only)),
        f"YAML cannot read this: {said}",
    )
    return Problem(file, mark.line + 1, mark.column + 1, "", shortened(row.strip()) or "the end of the file", expected)
