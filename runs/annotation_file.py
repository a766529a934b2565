"""Notes and tags that are added to a run afterwards, in a file beside its archive, which stays as it is.

`<run_id>.notes.jsonl` has one JSON object in each line, in the order of addition. A line is appended by one write, so
that several people can add at once and nothing is lost.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from runs.archive.checked import ArchiveError

SUFFIX = ".notes.jsonl"
_KINDS = ("note", "tag", "untag")


@dataclass(frozen=True)
class AddedNote:
    """A note and when it was added, in ISO 8601 (UTC)."""

    time: str
    text: str


@dataclass(frozen=True)
class Annotations:
    """What was added to a run: notes in order, and the present tags."""

    notes: tuple[AddedNote, ...] = ()
    tags: tuple[str, ...] = ()


def path_of(archive: Path) -> Path:
    """The file of the annotations of an archive."""
    return archive.with_name(archive.stem + SUFFIX)


def read(archive: Path) -> Annotations:
    """The annotations of an archive; none if there is no such file.

    Raises:
        ArchiveError: the file cannot be read, or a line of it is not an annotation.
    """
    path = path_of(archive)
    _refuse_irregular(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return Annotations()
    except (OSError, UnicodeDecodeError) as error:
        raise ArchiveError(f"{path}: cannot be read ({error})") from None
    notes: list[AddedNote] = []
    tags: dict[str, None] = {}
    for number, line in enumerate(lines, 1):
        kind, time, text = _parsed(path, number, line)
        if kind == "note":
            notes.append(AddedNote(time, text))
        elif kind == "tag":
            tags[text] = None
        else:
            tags.pop(text, None)
    return Annotations(tuple(notes), tuple(tags))


def _parsed(path: Path, number: int, line: str) -> tuple[str, str, str]:
    try:
        data = json.loads(line)
        (kind,) = (key for key in _KINDS if key in data)
        time, text = data["time"], data[kind]
    except (ValueError, TypeError, KeyError, RecursionError):
        time = text = kind = None
    if not (isinstance(time, str) and isinstance(text, str) and isinstance(kind, str)):
        expected = 'an annotation such as {"time": "2026-11-23T09:00:00Z", "tag": "bad"}'
        raise ArchiveError(f"{path}:{number}: found {line[:60]!r}, expected {expected}")
    return kind, time, text


def append(archive: Path, kind: str, text: str) -> None:
    """Append a "note", "tag" or "untag". Raises `ArchiveError` if it cannot be written."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    line = (json.dumps({"time": now, kind: text}) + "\n").encode()
    path = path_of(archive)
    _refuse_irregular(path)
    try:
        file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            if os.write(file, line) != len(line):
                raise ArchiveError(f"{path}: the disk is full")
            os.fsync(file)
        finally:
            os.close(file)
    except OSError as error:
        raise ArchiveError(f"{path}: cannot be written ({error.strerror})") from None


def _refuse_irregular(path: Path) -> None:
    """Refuse what is there and no file: a named pipe would keep its reader waiting."""
    if os.path.lexists(path) and not path.is_file():
        raise ArchiveError(f"{path}: this is not a regular file")
