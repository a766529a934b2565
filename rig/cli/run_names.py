"""Archives named on the command line."""

from __future__ import annotations

from pathlib import Path

from rig.cli import recovery_notice
from runs import run_names


def resolve(name: Path) -> Path:
    """Find an archive as `runs.run_names.resolve` does; report interrupted runs beside it."""
    recovery_notice.notify((run_names.archive_at(name) or name).parent)
    return run_names.resolve(name)
