"""Report interrupted runs and the command that recovers their journals; a running experiment does not count."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import typer

_NAMED = 3


@cache
def notify(folder: Path) -> None:
    """Report once, on standard error, the journals of a folder without an archive."""
    from runs.recovery import orphans

    left = orphans(folder)
    if not left:
        return
    names = ", ".join(path.name for path in left[:_NAMED]) + (", .." if len(left) > _NAMED else "")
    count = "a run was cut off" if len(left) == 1 else f"{len(left)} runs were cut off"
    typer.echo(f"{count} ({names}): `rig recover {folder}` makes archives of what was recorded", err=True)
