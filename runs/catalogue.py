"""The catalogue of a folder: one line per archive, cached in an index.

An entry is valid while size and time of its file are unchanged. A missing, damaged or foreign index is rebuilt; a
read-only folder works without one. There is no lock: of two concurrent writers the later wins, and both are correct.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from runs import annotation_file, arguments
from runs.archive.checked import ArchiveError, opened
from runs.archive.writer import SUFFIX
from runs.data_folder import DATA
from runs.overwriting import write_text
from runs.plain_file import read_plain
from runs.pressure_cycles import pressure_cycles
from runs.records import MODEL_ALONE

INDEX = ".catalogue.json"
_FORM = 5
"""Increased when `Entry` changes."""
_TEXTS = ("run_id", "title", "start_time", "status", "executor", "operator", "notes")
_ENTRIES = "a list of entries, as catalogue() returns it"


@dataclass(frozen=True)
class Entry:
    """One archive. `problem` says why an archive could not be read; everything else is then empty."""

    file: str
    run_id: str = ""
    title: str = ""
    start_time: str = ""
    duration_s: float = 0.0
    status: str = ""
    protocol: str = ""
    rig: str = ""
    model: str = ""
    executor: str = ""
    simulated: bool = False
    operator: str = ""
    notes: str = ""
    frames: int = 0
    mean_error_mm: float | None = None
    """None where no tip was measured."""
    max_error_mm: float | None = None
    specimen: str = ""
    pressure_cycles: int | None = None
    """As `runs.pressure_cycles` counts them; None without a specimen, and for what is no experiment of its own."""
    study: str = ""
    study_role: str = ""
    study_number: int | None = None
    study_block: int | None = None
    study_sha256: str = ""
    """As `runs.records.StudyRun` has them; empty or None for a run that belongs to no study."""
    tags: tuple[str, ...] = ()
    """Added afterwards; not in the index."""
    problem: str = ""


@dataclass(frozen=True)
class _CachedEntry:
    """Index record of a file: its size and time [ns] when it was read, and its entry."""

    stamp: tuple[int, int]
    entry: Entry


@dataclass(frozen=True)
class _Index:
    """Content of the index file."""

    form: int
    files: dict[str, _CachedEntry]


_INDEX = TypeAdapter(_Index)


def catalogue(folder: Path | str = DATA) -> tuple[Entry, ...]:
    """Return the archives of a folder, newest first, unreadable ones last; none if the folder does not exist.

    Raises:
        ArgumentError: the folder is no path.
    """
    place = arguments.path("folder", folder, "the path of a folder of archives")
    known = _load(place / INDEX)
    now: dict[str, _CachedEntry] = {}
    for name, stamp in _archives(place):
        before = known.get(name)
        now[name] = before if before is not None and before.stamp == stamp else _CachedEntry(stamp, _read(place / name))
    if now != known:
        _store(place / INDEX, now)
    entries = (_annotated(place, cached.entry) for cached in now.values())
    return tuple(sorted(entries, key=lambda e: (e.start_time, e.file), reverse=True))


def _annotated(place: Path, entry: Entry) -> Entry:
    try:
        return replace(entry, tags=annotation_file.read(place / entry.file).tags)
    except ArchiveError as error:
        return replace(entry, problem=str(error))


def specimen_cycles(entries: Iterable[Entry], specimen: str) -> tuple[int, int]:
    """Return the pressure cycles of a specimen, and the number of its runs that they are counted over.

    Raises:
        ArgumentError: an argument is of another type.
    """
    arguments.texts({"specimen": specimen})
    listed = arguments.items("entries", entries, Entry, _ENTRIES)
    counts = [e.pressure_cycles for e in listed if e.specimen == specimen and e.pressure_cycles is not None]
    return sum(counts), len(counts)


def search(
    entries: Iterable[Entry],
    text: str = "",
    *,
    since: str = "",
    until: str = "",
    tag: str = "",
    specimen: str = "",
    study: str = "",
) -> tuple[Entry, ...]:
    """Return the entries that match all given filters.

    `text`: words to find in any field; `since` and `until`: dates or times as ISO 8601 begins (`2026-11`,
    `2026-11-21T14`), both included.

    Raises:
        ArgumentError: an argument is of another type.
    """
    filters = {"text": text, "since": since, "until": until, "tag": tag, "specimen": specimen, "study": study}
    arguments.texts(filters)
    words = text.lower().split()
    return tuple(
        entry
        for entry in arguments.items("entries", entries, Entry, _ENTRIES)
        if all(word in _words(entry) for word in words)
        and (not tag or tag in entry.tags)
        and (not specimen or entry.specimen == specimen)
        and (not study or entry.study == study)
        and entry.start_time >= since
        and entry.start_time[: len(until)] <= until
    )


def _archives(folder: Path) -> list[tuple[str, tuple[int, int]]]:
    try:
        with os.scandir(folder) as files:
            found = [file for file in files if file.name.endswith(SUFFIX) and file.is_file()]
            stats = [(file.name, file.stat()) for file in found]
    except OSError:
        return []
    return [(name, (stat.st_size, stat.st_mtime_ns)) for name, stat in stats]


def _read(path: Path) -> Entry:
    """Return the catalogue entry of an archive; reads only the datasets that it needs."""
    try:
        with opened(path) as archive:
            error = archive.value("entry/tip/error_mm")
            known = error[np.isfinite(error)]
            specimen = archive.value("entry/sample/name") if archive.fields("entry/sample") else ""
            own = not archive.value("entry/parent") and archive.value("entry/executor") != MODEL_ALONE
            cycles = pressure_cycles(archive.value("entry/pressure/measured_bar")) if specimen and own else None
            study = {}
            if archive.fields("entry/study"):
                study = {
                    "study": archive.value("entry/study/name"),
                    "study_role": archive.value("entry/study/role"),
                    "study_number": int(archive.value("entry/study/number")),
                    "study_block": int(archive.value("entry/study/block")),
                    "study_sha256": archive.value("entry/study/sha256"),
                }
            return Entry(
                file=path.name,
                **{name: archive.value(f"entry/{name}") for name in _TEXTS},
                protocol=archive.value("entry/protocol/name"),
                rig=archive.value("entry/rig/name"),
                model=archive.value("entry/model/variant"),
                duration_s=float(archive.value("entry/duration")),
                simulated=bool(archive.value("entry/simulated")),
                frames=len(error),
                mean_error_mm=float(known.mean()) if len(known) else None,
                max_error_mm=float(known.max()) if len(known) else None,
                specimen=specimen,
                pressure_cycles=cycles,
                **study,
            )
    except ArchiveError as fault:
        return Entry(path.name, problem=str(fault))


def _load(path: Path) -> dict[str, _CachedEntry]:
    with suppress(OSError, ValueError, RecursionError):
        index = _INDEX.validate_json(read_plain(path), strict=True)
        if index.form == _FORM:
            return {name: cached for name, cached in index.files.items() if cached.entry.file == name}
    return {}


def _store(path: Path, known: dict[str, _CachedEntry]) -> None:
    """Write the index if possible; it is only a cache."""
    with suppress(OSError, ValueError):  # a file's name may be no text
        write_text(path, _INDEX.dump_json(_Index(_FORM, known)).decode())


def _words(entry: Entry) -> str:
    simulated = "simulated" if entry.simulated else ""
    fields = (entry.file, entry.title, entry.start_time, entry.status, entry.protocol, entry.rig, entry.model)
    return " ".join(
        (
            *fields,
            entry.specimen,
            entry.study,
            *entry.tags,
            entry.executor,
            simulated,
            entry.operator,
            entry.notes,
            entry.problem,
        )
    ).lower()
