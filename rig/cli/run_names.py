"""Archives named on the command line, and the interrupted runs beside them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import typer

from runs import run_names

_NAMED = 3


@cache
def report_interrupted(folder: Path) -> None:
    """Report once, on standard error, the journals of a folder without an archive, but not that of a running one."""
    from runs.recovery import orphans

    left = orphans(folder)
    if not left:
        return
    names = ", ".join(path.name for path in left[:_NAMED]) + (", .." if len(left) > _NAMED else "")
    count = "a run was cut off" if len(left) == 1 else f"{len(left)} runs were cut off"
    typer.echo(f"{count} ({names}): `rig recover {folder}` makes archives of what was recorded", err=True)


def resolve(name: Path) -> Path:
    """Find an archive as `runs.run_names.resolve` does; report interrupted runs beside it."""
    report_interrupted((run_names.archive_at(name) or name).parent)
    return run_names.resolve(name)
