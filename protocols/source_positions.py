"""YAML text -> plain data that remembers where each value was written.

PyYAML composes the nodes; the values are made here, because YAML 1.1 has readings that surprise (010 is 8, 1:30 is
90, `no` is false, a key given twice silently wins) and none of them may pass unnoticed.
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

_TAG = "tag:yaml.org,2002:"
_ALIKE = re.compile(r"[\n \"-;=>@-~\xa0-\ud7ff]*")
"""Texts without the signs (tab, !, ?, <) that libyaml and PyYAML's own reader take differently."""
_DECIMAL_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_DECIMAL_FLOAT = re.compile(r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+)([eE][-+]?[0-9]+)?")


@dataclass
class SourcePosition:
    """Where one value stands: its own place, its key's place, its source text, and the marks inside it.

    `line` and `column` count from 1; `note` is what YAML makes of a value that people rarely mean; `children` are by
    key or by list index.
    """

    line: int
    column: int
    source: str
    key_line: int = 0
    key_column: int = 0
    quoted: bool = False
    note: str = ""
    children: dict[str | int, SourcePosition] = field(default_factory=dict)


@dataclass(frozen=True)
class Document:
    """A YAML file: its name as the user gave it, its text, its plain data, the marks, and the faults of its writing.

    `data` is made of dict (text keys), list, str, int, float, bool and, where a value was left out or cannot be
    meant, None. `soft` are the places of problems that a model, which knows what is expected there, can say better.
    """

    file: str
    text: str
    data: dict[str, Any]
    marks: SourcePosition
    problems: tuple[Problem, ...] = ()
    soft: frozenset[tuple[int, int]] = frozenset()

    def mark(self, path: tuple[str | int, ...]) -> SourcePosition:
        """The mark of the deepest existing value on the way along `path`."""
        mark = self.marks
        for step in path:
            if step not in mark.children:
                break
            mark = mark.children[step]
        return mark


def path_text(path: tuple[str | int, ...]) -> str:
    """A path as a person says it: ('steps', 2, 'ramp') -> 'steps #3, ramp'."""
    words: list[str] = []
    for step in path:
        if isinstance(step, int) and words:
            words[-1] += f" #{step + 1}"
        else:
            words.append(str(step))
    return ", ".join(words)


class TooDeepError(yaml.MarkedYAMLError):
    """Nesting beyond anything a rig or a protocol needs."""


class _Bounded(Composer):
    """PyYAML's composer with a bound on nesting."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise TooDeepError(problem="too deep", problem_mark=self.peek_event().start_mark)  # type: ignore[attr-defined]
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Loader(_Bounded, yaml.SafeLoader):
    """Reads slowly and says well what is wrong."""


if yaml.__with_libyaml__:
    from yaml.cyaml import CParser  # type: ignore[attr-defined]

    class _FastLoader(_Bounded, CParser, Resolver):
        """Reads with libyaml, in a sixth of the time; its composer has no bound on nesting, so PyYAML's goes first."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            _Bounded.__init__(self)
            Resolver.__init__(self)

        def compose_scalar_node(self, anchor: dict[Any, yaml.Node]) -> yaml.ScalarNode:
            node = super().compose_scalar_node(anchor)
            node.style = node.style or None  # libyaml says "" of a plain scalar
            if not node.value and node.style is None:
                raise yaml.MarkedYAMLError(problem="a value is missing")  # and libyaml marks the place after it
            return node

    _FAST: type[Any] = _FastLoader
else:
    _FAST = _Loader


def compose(text: str) -> yaml.Node | None:
    """The node tree of `text`, None for an empty document; raises `yaml.YAMLError`.

    PyYAML's own reader, whose messages are translated, says what is wrong with a text that libyaml refuses.
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
    """Turns nodes into data and marks, collecting the faults of writing on the way."""

    def __init__(self, file: str, text: str) -> None:
        self.file = file
        self.text = text
        self.problems: list[Problem] = []
        self.soft: set[tuple[int, int]] = set()
        self._open: set[int] = set()
        self._size = 0

    @property
    def too_large(self) -> bool:
        """True when the file, with its aliases spelt out, has more values than any sensible one."""
        return self._size > LARGEST

    def value(self, node: yaml.Node, path: tuple[str | int, ...]) -> tuple[Any, SourcePosition]:
        """The data of a node and its mark."""
        self._size += 1
        mark = self._mark(node)
        if self._size > LARGEST:
            return None, mark
        if id(node) in self._open:
            self._fault(mark, path, "an alias (*name) inside what it stands for", "something that ends")
            return None, mark
        self._open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, path, mark), mark
            if isinstance(node, yaml.SequenceNode):
                return self._sequence(node, path, mark), mark
            assert isinstance(node, yaml.ScalarNode)
            return self._scalar(node, path, mark), mark
        finally:
            self._open.discard(id(node))

    def _mapping(self, node: yaml.MappingNode, path: tuple[str | int, ...], mark: SourcePosition) -> dict[str, Any]:
        self._check_tag(node, mark, path, "map")
        data: dict[str, Any] = {}
        merged: list[tuple[yaml.Node, SourcePosition]] = []
        for key_node, value_node in node.value:
            key_mark = self._mark(key_node)
            if not isinstance(key_node, yaml.ScalarNode):
                self._fault(key_mark, path, key_mark.source, "a word as the key before ':'",
                            "text in quotes" if "{" in key_mark.source else "")  # fmt: skip
                continue
            key = key_node.value
            if key_node.tag == f"{_TAG}merge":
                merged.append((value_node, key_mark))
                continue
            here = (*path, key)
            if key in data:
                first = mark.children[key].key_line
                self._fault(
                    key_mark, here, f"{key}, for the second time", f"each key once; the first is in line {first}"
                )
                continue
            data[key], child = self._child(value_node, here, key_mark)
            mark.children[key] = child
        for value_node, key_mark in merged:
            self._merge(value_node, key_mark, path, data, mark)
        return data

    def _child(
        self, node: yaml.Node, path: tuple[str | int, ...], key_mark: SourcePosition
    ) -> tuple[Any, SourcePosition]:
        value, mark = self.value(node, path)
        child = replace(mark, key_line=key_mark.line, key_column=key_mark.column)
        if value is None and node.tag == f"{_TAG}null":
            child = replace(child, line=key_mark.line, column=key_mark.column)
            self._empty(child, path, str(path[-1]))
        return value, child

    def _empty(self, mark: SourcePosition, path: tuple[str | int, ...], key: str) -> None:
        """A key without a value; often it is a colon or a decimal comma gone wrong."""
        glued = re.fullmatch(r"(\w+)(:| +)(\S.*)", key)
        if key.isdigit():
            self._fault(mark, path, f",{key}", "a decimal point, or ': ' and a value after this key")
        elif glued:
            wish = f"'{glued[1]}: {glued[3]}'"
            self._fault(mark, path, key, "a key, then a colon and a space, then its value", wish)
        else:
            mark.note = "if the lines below belong to it, indent them further"
            self.soft.add((mark.line, mark.column))
            self._fault(mark, path, mark.source or "nothing", f"a value after '{key}:'; {mark.note}")

    def _merge(
        self,
        node: yaml.Node,
        key_mark: SourcePosition,
        path: tuple[str | int, ...],
        data: dict[str, Any],
        mark: SourcePosition,
    ) -> None:
        """`<<: *name`: the keys of another mapping, where the own keys win."""
        sources = node.value if isinstance(node, yaml.SequenceNode) else [node]
        for source in sources:
            if not isinstance(source, yaml.MappingNode):
                self._fault(key_mark, path, self._mark(source).source, "a mapping after '<<:'")
                continue
            values, marks = self.value(source, path)
            for key, value in (values or {}).items():
                if key not in data:
                    data[key] = value
                    mark.children[key] = marks.children[key]

    def _sequence(self, node: yaml.SequenceNode, path: tuple[str | int, ...], mark: SourcePosition) -> list[Any]:
        self._check_tag(node, mark, path, "seq")
        data = []
        for index, item in enumerate(node.value):
            value, child = self.value(item, (*path, index))
            if value is None and item.tag == f"{_TAG}null":
                self._fault(child, (*path, index), child.source or "nothing", "a value for this item of the list")
            data.append(value)
            mark.children[index] = child
        return data

    def _scalar(self, node: yaml.ScalarNode, path: tuple[str | int, ...], mark: SourcePosition) -> Any:
        text: str = node.value
        kind = node.tag.removeprefix(_TAG)
        mark.quoted = node.style is not None
        readers: dict[str, Callable[[str, SourcePosition, tuple[str | int, ...]], Any]] = {
            "int": self._int,
            "float": self._float,
            "bool": self._bool,
        }
        if kind == "null":
            return None
        if kind in readers:
            return readers[kind](text, mark, path)
        if kind not in {"str", "timestamp", "value", "merge"}:
            self._fault(mark, path, mark.source, f"a plain value: the tag {_tag_text(node.tag)} is not understood")
        return text

    def _int(self, text: str, mark: SourcePosition, path: tuple[str | int, ...]) -> int | None:
        if not _DECIMAL_INT.fullmatch(text):
            self._surprise(text, mark, path)
        elif len(text) > LONGEST_NUMBER:
            self._fault(mark, path, mark.source, "a number of a sensible size")
        else:
            return int(text)
        return None

    def _float(self, text: str, mark: SourcePosition, path: tuple[str | int, ...]) -> float | None:
        if _DECIMAL_FLOAT.fullmatch(text):
            return float(text)
        if text.lstrip("+-").lower() in {".inf", ".nan"}:
            return float(text.replace(".", ""))
        self._surprise(text, mark, path)
        return None

    def _bool(self, text: str, mark: SourcePosition, path: tuple[str | int, ...]) -> bool | None:
        if text.lower() in {"true", "false"}:
            return text.lower() == "true"
        mark.note = f"YAML reads a bare {text} as {'true' if text.lower() in {'yes', 'on'} else 'false'}"
        self.soft.add((mark.line, mark.column))
        self._fault(mark, path, text, f"true or false, or text in quotes; {mark.note}")
        return None

    def _surprise(self, text: str, mark: SourcePosition, path: tuple[str | int, ...]) -> None:
        """A number written in a way that YAML 1.1 reads as few people know."""
        digits = text.replace("_", "").lstrip("+-").lower()
        if ":" in text:
            mark.note = "YAML reads digits with a colon as base 60"
        elif digits.startswith(("0x", "0b")):
            mark.note = "write it in decimal"
        elif digits.startswith("0") and digits.isdigit():
            mark.note = "YAML reads a leading zero as octal"
        else:
            mark.note = "write it without underscores"
        self.soft.add((mark.line, mark.column))
        self._fault(mark, path, mark.source, f"a plain decimal number; {mark.note}")

    def _check_tag(self, node: yaml.Node, mark: SourcePosition, path: tuple[str | int, ...], kind: str) -> None:
        if node.tag != _TAG + kind:
            self._fault(mark, path, _tag_text(node.tag), "no tag: plain lists and mappings only")

    def _mark(self, node: yaml.Node) -> SourcePosition:
        start, end = node.start_mark, node.end_mark
        source = " ".join(self.text[start.index : min(end.index, start.index + LONGEST_SOURCE)].split())
        return SourcePosition(start.line + 1, start.column + 1, source)

    def _fault(
        self, mark: SourcePosition, path: tuple[str | int, ...], value: str, expected: str, suggestion: str = ""
    ) -> None:
        self.problems.append(
            Problem(self.file, mark.line, mark.column, path_text(path), shortened(value), expected, suggestion)
        )


def shortened(text: str, width: int = 60) -> str:
    """`text` on one line, cut to `width` characters."""
    line = " ".join(text.split())
    return line if len(line) <= width else line[: width - 1] + "…"


def _tag_text(tag: str) -> str:
    return "!!" + tag.removeprefix(_TAG) if tag.startswith(_TAG) else tag
