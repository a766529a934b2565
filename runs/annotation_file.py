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
from runs.plain_file import IrregularFileError, open_plain, read_plain

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
    path, data = path_of(archive), content(archive)
    # A byte that is no UTF-8 spoils its letter, not the notes.
    lines = (data or b"").decode("utf-8", errors="replace").splitlines()
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


def content(archive: Path) -> bytes | None:
    """The bytes of the annotations of an archive; None if there is no such file.

    Raises:
        ArchiveError: the file cannot be read, or is no regular file.
    """
    path = path_of(archive)
    try:
        return read_plain(path)
    except FileNotFoundError:
        return None
    except IrregularFileError as error:
        raise ArchiveError(str(error)) from None
    except OSError as error:
        raise ArchiveError(f"{path}: cannot be read ({error.strerror})") from None


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
    try:
        file = open_plain(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        try:
            if os.write(file, line) != len(line):
                raise ArchiveError(f"{path}: the disk is full")
            os.fsync(file)
        finally:
            os.close(file)
    except IrregularFileError as error:
        raise ArchiveError(str(error)) from None
    except OSError as error:
        raise ArchiveError(f"{path}: cannot be written ({error.strerror})") from None
