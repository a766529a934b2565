"""Archives by path, run id, unique part of a run id, or `last`."""

from __future__ import annotations

from pathlib import Path

from runs.archive.writer import SUFFIX, ArchiveError
from runs.catalogue import catalogue
from runs.data_folder import DATA as DATA_FOLDER
from runs.data_folder import LAST

DATA = Path(DATA_FOLDER)
MOST_SHOWN = 5


def archive_at(name: Path) -> Path | None:
    """Return the archive that a path, or a run id here or in the data folder, names; None if there is none.

    Raises:
        ArchiveError: the path cannot be read.
    """
    by_id: tuple[Path, ...] = ()
    if name.name:
        by_id = (name.with_name(name.name + SUFFIX), DATA / f"{name.name}{SUFFIX}")
    try:
        return next((candidate for candidate in (name, *by_id) if candidate.is_file()), None)
    except OSError as error:
        raise ArchiveError(f"{name}: {error.strerror}") from None


def resolve(name: Path | str) -> Path:
    """Find an archive by path, by a run id or a unique part of one in the data folder, or by `last` (the newest).

    Raises:
        ArchiveError: no archive matches, or several do.
    """
    if not isinstance(name, Path | str):
        raise ArchiveError(f"{name!r}: expected a path, a run id or a part of one, or `last`")
    name = Path(name)
    if (found := archive_at(name)) is not None:
        return found
    if len(name.parts) == 1 and name.name and (found := _in_data(name.name)) is not None:
        return found
    if name.is_dir():
        raise ArchiveError(f"{name}: this is a folder, not an archive; `rig runs FOLDER` lists the archives in one")
    raise ArchiveError(f"{name}: no such archive, here or in data/; `rig runs` lists what there is")


def _in_data(part: str) -> Path | None:
    """Return the archive in the data folder for `last` or a part of a run id; None where there is none."""
    if part == LAST:
        entries = catalogue(DATA)
        readable = [entry for entry in entries if not entry.problem]
        if entries and not readable:
            raise ArchiveError(f"{LAST}: no archive in data/ is readable; the newest: {entries[0].problem}")
        return DATA / readable[0].file if readable else None
    try:
        stems = sorted(path.stem for path in DATA.iterdir() if path.suffix == SUFFIX and part in path.stem)
    except OSError:
        return None
    # A replay keeps the name of its run and appends to it.
    ending = [stem for stem in stems if stem.endswith(f"-{part}")]
    if len(ending) == 1:
        stems = ending
    if len(stems) > 1:
        shown = ", ".join(stems[:MOST_SHOWN]) + (", .." if len(stems) > MOST_SHOWN else "")
        raise ArchiveError(f"{part}: {len(stems)} runs in data/ have this in their id: {shown}; give more of it")
    return DATA / f"{stems[0]}{SUFFIX}" if stems else None
