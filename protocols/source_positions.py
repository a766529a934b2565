"""Converts YAML text to plain data with the source position of each value.

PyYAML composes the nodes; this module constructs the values, because YAML 1.1 has surprising rules (010 is 8, 1:30 is
90, `no` is false, the last duplicate of a key wins), and each of these is reported.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.resolver import Resolver

from protocols.problems import Problem

DEEPEST = 40
LARGEST = 50_000
LONGEST_SOURCE = 200
LONGEST_NUMBER = 30
SHOWN_CHARACTERS = 60

_TAG = "tag:yaml.org,2002:"
_ALIKE = re.compile(r"[\n \"-;=>@-~\xa0-\ud7ff]*")
"""Texts without the characters (tab, !, ?, <) that libyaml and the pure Python parser treat differently."""
_DECIMAL_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_EXPONENT = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+")
"""Numbers that YAML 1.1 reads as text, because they lack a point or the sign of the exponent."""
_DECIMAL_FLOAT = re.compile(r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)([eE][-+]?[0-9]+)?")


YamlPath = tuple[str | int, ...]
"""Keys and list indices from the top of a document to a value."""


@dataclass
class SourcePosition:
    """Source position of a value and of its key, its source text, and the positions of the values inside it.

    `line` and `column` count from 1; `hint` explains how YAML reads an ambiguous value; `children` are by key or
    list index. `file` names the file of a value that was put over the document; empty for its own.
    """

    line: int
    column: int
    source: str
    key_line: int = 0
    key_column: int = 0
    quoted: bool = False
    hint: str = ""
    file: str = ""
    children: dict[str | int, SourcePosition] = field(default_factory=dict)


@dataclass(frozen=True)
class Document:
    """A YAML file: name as given by the user, text, plain data, source positions, and syntax problems.

    `data` is made of dict (text keys), list, str, int, float, bool and None for missing and
    invalid values. `replaceable` are the places of problems for which the model may have a more specific one.
    """

    file: str
    text: str
    data: dict[str, Any]
    positions: SourcePosition
    problems: tuple[Problem, ...] = ()
    replaceable: frozenset[tuple[int, int]] = frozenset()

    def position(self, path: tuple[str | int, ...]) -> SourcePosition:
        """The position of the deepest existing value along `path`."""
        position = self.positions
        for step in path:
            if step not in position.children:
                break
            position = position.children[step]
        return position

    def problem(
        self,
        path: tuple[str | int, ...],
        expected: str,
        value: str | None = None,
        suggestion: str = "",
        *,
        at_key: bool = False,
    ) -> Problem:
        """The problem of the value at `path`, which is quoted as the file has it unless `value` states it.

        at_key: its place is that of the key, where there is one.
        """
        position = self.position(path)
        place = position.line, position.column
        if at_key and position.key_line:
            place = position.key_line, position.key_column
        found = position.source if value is None else value
        return Problem(position.file or self.file, *place, path_text(path), found, expected, suggestion)


def path_text(path: tuple[str | int, ...]) -> str:
    """A path in words: ('steps', 2, 'ramp') -> 'steps #3, ramp'."""
    words: list[str] = []
    for step in path:
        if isinstance(step, int) and words:
            words[-1] += f" #{step + 1}"
        else:
            words.append(str(step))
    return ", ".join(words)


class NestingError(yaml.MarkedYAMLError):
    """The nesting is too deep."""


class _Bounded(Composer):
    """PyYAML's composer with a limit on nesting."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise NestingError(problem="too deep", problem_mark=self.peek_event().start_mark)  # type: ignore[attr-defined]
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Loader(_Bounded, yaml.SafeLoader):
    """The pure Python parser: slow, with good error messages."""


if yaml.__with_libyaml__:
    from yaml.cyaml import CParser  # type: ignore[attr-defined]

    class _FastLoader(_Bounded, CParser, Resolver):
        """libyaml's parser, six times faster, with PyYAML's composer, which can limit the nesting."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            _Bounded.__init__(self)
            Resolver.__init__(self)

        def compose_scalar_node(self, anchor: dict[Any, yaml.Node]) -> yaml.ScalarNode:
            node = super().compose_scalar_node(anchor)
            node.style = node.style or None  # libyaml has "" for a plain scalar
            if not node.value and node.style is None:
                raise yaml.MarkedYAMLError(problem="a value is missing")  # libyaml gives the position after it
            return node

    _FAST: type[Any] = _FastLoader
else:
    _FAST = _Loader


def compose(text: str) -> yaml.Node | None:
    """The node tree of `text`, None for an empty document; raises `yaml.YAMLError`.

    A text that libyaml rejects is parsed again by the pure Python parser for its error message.
    """
    if _ALIKE.fullmatch(text):
        with suppress(yaml.YAMLError):
            return _composed(_FAST, text)
    return _composed(_Loader, text)


def _composed(loader_class: type[Any], text: str) -> yaml.Node | None:
    loader = loader_class(text)
    try:
        node: yaml.Node | None = loader.get_single_node()
        return node
    finally:
        loader.dispose()


class Reader:
    """Converts nodes to data and positions and collects the problems."""

    def __init__(self, file: str, text: str) -> None:
        self.file = file
        self.text = text
        self.problems: list[Problem] = []
        self.replaceable: set[tuple[int, int]] = set()
        self._open: set[int] = set()
        self._size = 0

    @property
    def too_large(self) -> bool:
        """True if the file, with expanded aliases, has more than `LARGEST` values."""
        return self._size > LARGEST

    def value(self, node: yaml.Node, path: tuple[str | int, ...]) -> tuple[Any, SourcePosition]:
        """The data of a node and its position."""
        self._size += 1
        position = self._position(node)
        if self._size > LARGEST:
            return None, position
        if id(node) in self._open:
            self._fault(position, path, "an alias (*name) inside what it stands for", "something that ends")
            return None, position
        self._open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, path, position), position
            if isinstance(node, yaml.SequenceNode):
                return self._sequence(node, path, position), position
            assert isinstance(node, yaml.ScalarNode)
            return self._scalar(node, path, position), position
        finally:
            self._open.discard(id(node))

    def _mapping(self, node: yaml.MappingNode, path: tuple[str | int, ...], position: SourcePosition) -> dict[str, Any]:
        self._check_tag(node, position, path, "map")
        data: dict[str, Any] = {}
        merged: list[tuple[yaml.Node, SourcePosition]] = []
        for key_node, value_node in node.value:
            key_position = self._position(key_node)
            if not isinstance(key_node, yaml.ScalarNode):
                self._fault(key_position, path, key_position.source, "a word as the key before ':'",
                            "text in quotes" if "{" in key_position.source else "")  # fmt: skip
                continue
            key = key_node.value
            if key_node.tag == f"{_TAG}merge":
                merged.append((value_node, key_position))
                continue
            here = (*path, key)
            if key in data:
                first = position.children[key].key_line
                self._fault(
                    key_position, here, f"{key}, for the second time", f"each key once; the first is in line {first}"
                )
                continue
            data[key], child = self._child(value_node, here, key_position)
            position.children[key] = child
        for value_node, key_position in merged:
            self._merge(value_node, key_position, path, data, position)
        return data

    def _child(
        self, node: yaml.Node, path: tuple[str | int, ...], key_position: SourcePosition
    ) -> tuple[Any, SourcePosition]:
        value, position = self.value(node, path)
        child = replace(position, key_line=key_position.line, key_column=key_position.column)
        if value is None and node.tag == f"{_TAG}null":
            child = replace(child, line=key_position.line, column=key_position.column)
            self._empty(child, path, str(path[-1]))
        return value, child

    def _empty(self, position: SourcePosition, path: tuple[str | int, ...], key: str) -> None:
        """Report a key without a value, often caused by a missing space after a colon or by a decimal comma."""
        glued = re.fullmatch(r"(\w+)(:| +)(\S.*)", key)
        if key.isdigit():
            self._fault(position, path, f",{key}", "a decimal point, or ': ' and a value after this key")
        elif glued:
            wish = f"'{glued[1]}: {glued[3]}'"
            self._fault(position, path, key, "a key, then a colon and a space, then its value", wish)
        else:
            position.hint = "if the lines below belong to it, indent them further"
            self.replaceable.add((position.line, position.column))
            self._fault(position, path, position.source or "nothing", f"a value after '{key}:'; {position.hint}")

    def _merge(
        self,
        node: yaml.Node,
        key_position: SourcePosition,
        path: tuple[str | int, ...],
        data: dict[str, Any],
        position: SourcePosition,
    ) -> None:
        """`<<: *name`: the keys of another mapping, where the own keys win."""
        sources = node.value if isinstance(node, yaml.SequenceNode) else [node]
        for source in sources:
            if not isinstance(source, yaml.MappingNode):
                self._fault(key_position, path, self._position(source).source, "a mapping after '<<:'")
                continue
            values, positions = self.value(source, path)
            for key, value in (values or {}).items():
                if key not in data:
                    data[key] = value
                    position.children[key] = positions.children[key]

    def _sequence(self, node: yaml.SequenceNode, path: tuple[str | int, ...], position: SourcePosition) -> list[Any]:
        self._check_tag(node, position, path, "seq")
        data = []
        for index, item in enumerate(node.value):
            value, child = self.value(item, (*path, index))
            if value is None and item.tag == f"{_TAG}null":
                self._fault(child, (*path, index), child.source or "nothing", "a value for this item of the list")
            data.append(value)
            position.children[index] = child
        return data

    def _scalar(self, node: yaml.ScalarNode, path: tuple[str | int, ...], position: SourcePosition) -> Any:
        text: str = node.value
        kind = node.tag.removeprefix(_TAG)
        position.quoted = node.style is not None
        readers: dict[str, Callable[[str, SourcePosition, tuple[str | int, ...]], Any]] = {
            "int": self._int,
            "float": self._float,
            "bool": self._bool,
        }
        if kind == "null":
            return None
        if kind in readers:
            return readers[kind](text, position, path)
        if kind == "str" and node.style is None and _EXPONENT.fullmatch(text):
            return float(text)
        if kind not in {"str", "timestamp", "value", "merge"}:
            self._fault(
                position, path, position.source, f"a plain value: the tag {_tag_text(node.tag)} is not understood"
            )
        return text

    def _int(self, text: str, position: SourcePosition, path: tuple[str | int, ...]) -> int | None:
        if not _DECIMAL_INT.fullmatch(text):
            self._surprise(text, position, path)
        elif len(text) > LONGEST_NUMBER:
            self._fault(position, path, position.source, "a number of a sensible size")
        else:
            return int(text)
        return None

    def _float(self, text: str, position: SourcePosition, path: tuple[str | int, ...]) -> float | None:
        if _DECIMAL_FLOAT.fullmatch(text):
            return float(text)
        if text.lstrip("+-").lower() in {".inf", ".nan"}:
            return float(text.replace(".", ""))
        self._surprise(text, position, path)
        return None

    def _bool(self, text: str, position: SourcePosition, path: tuple[str | int, ...]) -> bool | None:
        if text.lower() in {"true", "false"}:
            return text.lower() == "true"
        position.hint = f"YAML reads a bare {text} as {'true' if text.lower() in {'yes', 'on'} else 'false'}"
        self.replaceable.add((position.line, position.column))
        self._fault(position, path, text, f"true or false, or text in quotes; {position.hint}")
        return None

    def _surprise(self, text: str, position: SourcePosition, path: tuple[str | int, ...]) -> None:
        """Report a number with a surprising notation of YAML 1.1."""
        digits = text.replace("_", "").lstrip("+-").lower()
        if ":" in text:
            position.hint = "YAML reads digits with a colon as base 60"
        elif digits.startswith(("0x", "0b")):
            position.hint = "write it in decimal"
        elif digits.startswith("0") and digits.isdigit():
            position.hint = "YAML reads a leading zero as octal"
        else:
            position.hint = "write it without underscores"
        self.replaceable.add((position.line, position.column))
        self._fault(position, path, position.source, f"a plain decimal number; {position.hint}")

    def _check_tag(self, node: yaml.Node, position: SourcePosition, path: tuple[str | int, ...], kind: str) -> None:
        if node.tag != _TAG + kind:
            self._fault(position, path, _tag_text(node.tag), "no tag: plain lists and mappings only")

    def _position(self, node: yaml.Node) -> SourcePosition:
        start, end = node.start_mark, node.end_mark
        source = " ".join(self.text[start.index : min(end.index, start.index + LONGEST_SOURCE)].split())
        return SourcePosition(start.line + 1, start.column + 1, source)

    def _fault(
        self, position: SourcePosition, path: tuple[str | int, ...], value: str, expected: str, suggestion: str = ""
    ) -> None:
        self.problems.append(
            Problem(self.file, position.line, position.column, path_text(path), shortened(value), expected, suggestion)
        )


def shortened(text: str) -> str:
    """`text` on one line, cut to `SHOWN_CHARACTERS`."""
    line = " ".join(text.split())
    return line if len(line) <= SHOWN_CHARACTERS else line[: SHOWN_CHARACTERS - 1] + "…"


def _tag_text(tag: str) -> str:
    return "!!" + tag.removeprefix(_TAG) if tag.startswith(_TAG) else tag
