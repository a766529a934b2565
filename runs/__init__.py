"""Records of a run: journal, archive, catalogue, report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from runs.data_folder import DATA, LAST

if TYPE_CHECKING:
    from pathlib import Path

    from runs.run import Run

__all__ = ["DATA", "LAST", "open"]


def open(name: Path | str, *, force: bool = False) -> Run:
    """Open an archive by path, by a run id or a unique part of one in `data/`, or by `last`, the newest run.

    With `force` this process reads the archive also if it is damaged. Imports HDF5 on the first call.

    Raises:
        ArchiveError: no archive matches, several do, or the file is not an archive, or not as softrig wrote it.
    """
    from runs.archive import digest
    from runs.run import Run
    from runs.run_names import resolve

    path = resolve(name)
    if force:
        digest.accept(path)
    return Run(path)
