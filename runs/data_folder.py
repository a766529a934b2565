"""The folder of archives: its default, the name of its newest run, and run ids that are free in it."""

from __future__ import annotations

from pathlib import Path

DATA = "data"
"""Default folder of archives."""
LAST = "last"
"""Names the newest run."""


def free_id(folder: Path, stem: str) -> str:
    """Return a run id that is unique in the folder; two runs can start within one second."""
    candidate, n = stem, 1
    while any(folder.glob(f"{candidate}.*")):
        n += 1
        candidate = f"{stem}-{n}"
    return candidate
