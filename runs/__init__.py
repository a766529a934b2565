"""Records of a run: journal, archive, catalogue, report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from runs.run import Run


def open(path: Path | str) -> Run:
    """Open an archive; `ArchiveError` if it is not one. Imports HDF5 on the first call."""
    from runs.run import Run

    return Run(path)
