"""What a run leaves behind: journal, archive, catalogue, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from runs.run import Run


def open(path: Path | str) -> Run:
    """Open an archive; `runs.archive.writer.ArchiveError` where it is none. Imports HDF5 only now."""
    from runs.run import Run

    return Run(path)
