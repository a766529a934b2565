"""Reads, decodes and parses YAML files. The program reads all YAML through this module and `validate`."""

from __future__ import annotations

from pathlib import Path

import yaml

from protocols.problems import BadInputError, Problem, bad_input
from protocols.source_positions import Document, NestingError, Reader, compose, shortened
from protocols.validation import validate

__all__ = ["Document", "parse", "read", "read_text", "validate"]

LARGEST_FILE = 200_000


def read(path: Path) -> Document:
    """The document in a file; `BadInputError` if it is not a YAML mapping, else the problems are in the document."""
    return parse(read_text(path, LARGEST_FILE), str(path))


def read_text(path: Path, largest: int) -> str:
    """The text of a UTF-8 file of at most `largest` bytes, its lines ended by a line feed; or `BadInputError`."""

    def bad(expected: str, line: int = 0, column: int = 0, value: str = "") -> BadInputError:
        return BadInputError([Problem(str(path), line, column, "", value, expected)])

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
        return raw.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line = before.count(b"\n") + 1
        column = len(before[before.rfind(b"\n") + 1 :].decode("utf-8", "replace")) + 1
        raise bad(
            "UTF-8 text; save the file with that encoding", line, column, f"byte 0x{raw[error.start]:02x}"
        ) from None


def parse(text: str, file: str) -> Document:
    """The document in `text`; `file` is its name in messages."""
    try:
        node = compose(text)
    except yaml.YAMLError as error:
        raise BadInputError([_syntax_problem(error, text, file)]) from None
    except RecursionError:
        raise bad_input(file, "", "the file is nested too deeply") from None
    if node is None or (isinstance(node, yaml.ScalarNode) and not node.value and node.style is None):
        raise bad_input(file, "", "the file is empty")
    reader = Reader(file, text)
    data, positions = reader.value(node, ())
    if reader.too_large:
        expected = "the file is too large: with its aliases (*name) spelt out it has far too many values"
        raise bad_input(file, "", expected)
    if not isinstance(data, dict):
        kind = "a list" if isinstance(data, list) else shortened(positions.source)
        expected = "a mapping ('key: value' lines) at the top of the file"
        raise BadInputError([Problem(file, positions.line, positions.column, "", kind, expected)])
    return Document(file, text, data, positions, tuple(reader.problems), frozenset(reader.replaceable))


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
    """Translate an error message of PyYAML."""
    if isinstance(error, NestingError):
        mark = error.problem_mark
        return Problem(file, mark.line + 1 if mark else 0, 0, "", "", "the file is nested too deeply")
    if isinstance(error, yaml.reader.ReaderError):
        line = text.count("\n", 0, error.position) + 1
        column = error.position - (text.rfind("\n", 0, error.position) + 1) + 1
        found = f"the control character U+{int(error.character):04X}"
        return Problem(file, line, column, "", found, "text without control characters: is this a YAML file?")
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return Problem(file, 0, 0, "", "", f"YAML cannot read this: {error}")
    message = error.problem or error.context or ""
    mark = error.problem_mark
    if "unexpected end of stream" in message or (message.startswith("expected ','") and error.context_mark is not None):
        mark = error.context_mark or mark
    rows = text.split("\n")
    row = rows[mark.line] if mark.line < len(rows) else ""
    character = row[mark.column : mark.column + 1]
    expected = next(
        (words for key, words, only in _SYNTAX if key in message and (not only or character == only)),
        f"YAML cannot read this: {message}",
    )
    return Problem(file, mark.line + 1, mark.column + 1, "", shortened(row.strip()) or "the end of the file", expected)
