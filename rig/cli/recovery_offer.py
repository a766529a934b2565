"""Telling of runs that were cut off, and offering to make archives of their journals; a run that goes on is no such."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import typer

_NAMED = 3


@cache
def offer(folder: Path, ask: bool = True) -> None:
    """Say once, in one line on the error output, which journals of a folder have no archive; on a terminal, ask.

    `ask` is False where the operator has said that nobody is to be asked.
    """
    from runs.recovery import Fate, orphans, recover

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
        if outcome.fate is not Fate.ARCHIVED:
            typer.echo(f"{outcome.fate}  {outcome.archive or outcome.path}  {outcome.message}", err=True)
