"""Recovery after a crash: makes archives from orphaned journals; leaves unreadable files unchanged."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from runs import arguments
from runs.archive import writer as archive
from runs.archive.writer import ArchiveError, ArchiveInUseError
from runs.data_folder import DATA, free_id
from runs.export import foxglove
from runs.journal import journal
from runs.journal.append_only_file import JournalError, lock
from runs.run import Run


class RecoveryStatus(StrEnum):
    """Outcome of the recovery of a file."""

    RECOVERED = "recovered"
    FINALISED = "finalised"
    """The run was complete; only its archive was missing."""
    ARCHIVED = "archived"
    """No recovery needed."""
    RUNNING = "running"
    """Its writer is still running."""
    UNREADABLE = "unreadable"
    """Unreadable; unchanged."""
    REMOVED = "removed"
    """The remainder of an interrupted finalisation; removed."""


@dataclass(frozen=True)
class RecoveryOutcome:
    """Outcome for one file; `archive` is the archive of a journal, if there is one."""

    path: Path
    status: RecoveryStatus
    message: str
    archive: Path | None = None


def orphans(folder: Path | str) -> tuple[Path, ...]:
    """Return the journals in a folder that have no archive and no living writer; reads none of them.

    Raises:
        ArgumentError: the folder is no path.
    """
    return tuple(path for path in _journals(_place(folder)) if not _archive_of(path).exists() and not _locked(path))


def recover(folder: Path | str = DATA) -> tuple[RecoveryOutcome, ...]:
    """Make archives of the journals in a folder that have none, and remove the remainders of interrupted attempts.

    Safe to call again, and while runs are being recorded. An archive that cannot be opened is set aside under
    another name, never deleted, and made again from its journal.

    Raises:
        ArgumentError: the folder is no path.
    """
    place = _place(folder)
    return (*_leftovers(place), *(_recover(path) for path in _journals(place)))


def move_unused(source: Path, folder: Path) -> None:
    """Move journals and archives to another folder, unless a living process writes a journal of the source.

    Nothing is replaced: a file whose name is taken gets a free one. The source is removed when it is empty.
    """
    if any(_locked(path) for path in _journals(source)):
        return
    list(_leftovers(source))
    for stem in sorted({path.stem for path in source.iterdir() if path.suffix in (journal.SUFFIX, archive.SUFFIX)}):
        free = free_id(folder, stem)
        for path in (source / f"{stem}{suffix}" for suffix in (journal.SUFFIX, archive.SUFFIX)):
            if path.exists():
                path.rename(folder / f"{free}{path.suffix}")
    with suppress(OSError):
        source.rmdir()


def _place(folder: object) -> Path:
    return arguments.path("folder", folder, "the path of a folder of journals")


def _recover(path: Path) -> RecoveryOutcome:
    target = _archive_of(path)
    aside = ""
    if target.exists():
        try:
            Run(target)
        except ArchiveError:
            kept = _set_aside(target)
            aside = f"; the archive that was there cannot be opened and was kept as {kept.name}"
        else:
            return RecoveryOutcome(path, RecoveryStatus.ARCHIVED, "", target)
    try:
        archive.finalise(path)
        content = journal.read(path)
    except ArchiveInUseError:
        return RecoveryOutcome(path, RecoveryStatus.RUNNING, "its writer is alive")
    except (JournalError, ArchiveError) as fault:
        return RecoveryOutcome(path, RecoveryStatus.UNREADABLE, str(fault) + aside)
    rows = f"{len(content.samples)} samples, {len(content.observations)} frames, {len(content.pictures)} pictures"
    lost = f"; not readable: {'; '.join(map(str, content.damage))}" if content.damage else ""
    status = RecoveryStatus.RECOVERED if content.footer is None else RecoveryStatus.FINALISED
    return RecoveryOutcome(path, status, rows + lost + aside, target)


def _leftovers(folder: Path) -> Iterator[RecoveryOutcome]:
    """Remove archives that were never finished, unless someone holds the journal or HDF5 the file."""
    for path in _files(folder, archive.PART):
        source = path.with_name(path.name.removesuffix(archive.PART) + journal.SUFFIX)
        if not _locked(source) and not _locked(path):
            path.unlink(missing_ok=True)
            yield RecoveryOutcome(path, RecoveryStatus.REMOVED, "left by an interrupted finalisation")


def _journals(folder: Path) -> list[Path]:
    return [path for path in _files(folder, journal.SUFFIX) if not path.name.endswith(foxglove.SUFFIX)]


def _files(folder: Path, suffix: str) -> list[Path]:
    """Return the files of a folder whose names end so; a named pipe would keep its reader waiting."""
    return sorted(path for path in folder.glob(f"*{suffix}") if path.is_file())


def _archive_of(path: Path) -> Path:
    return path.with_suffix(archive.SUFFIX)


def _locked(path: Path) -> bool:
    """Return whether a living process holds a lock on a file."""
    if not path.is_file():
        return False
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        lock(handle)
    except BlockingIOError:
        return True
    else:
        return False
    finally:
        os.close(handle)


def _set_aside(path: Path) -> Path:
    """Rename a file to a free name that is not an archive's."""
    number = 1
    while (kept := path.with_name(f"{path.name}.unreadable-{number}")).exists():
        number += 1
    return path.rename(kept)
