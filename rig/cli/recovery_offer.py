"""Report interrupted runs and offer to recover their journals; a running experiment does not count."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import typer

_NAMED = 3


@cache
def offer(folder: Path, ask: bool = True) -> None:
    """Report once, on standard error, the journals of a folder without an archive; on a terminal, offer recovery.

    `ask` is False after --yes.
    """
    from runs.recovery import RecoveryStatus, orphans, recover

    left = orphans(folder)
    if not left:
        return
    names = ", ".join(path.name for path in left[:_NAMED]) + (", .." if len(left) > _NAMED else "")
    count = "a run was cut off" if len(left) == 1 else f"{len(left)} runs were cut off"
    typer.echo(f"{count} ({names}): `rig recover {folder}` makes archives of what was recorded", err=True)
    if not (ask and sys.stdin.isatty() and sys.stderr.isatty()):
        return
    if not typer.confirm("Do that now?", default=True, err=True):
        return
    for outcome in recover(folder):
        if outcome.fate is not RecoveryStatus.ARCHIVED:
            typer.echo(f"{outcome.fate}  {outcome.archive or outcome.path}  {outcome.message}", err=True)
