"""Saves work that a process repeats if it runs many commands."""

from __future__ import annotations

import functools
import gc

import typer.main


def avoid_repeated_work() -> None:
    """Exclude imported modules from garbage collection, and build the command line once; both take a tenth of the time.

    Call this after the imports.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    typer.main.get_command = functools.cache(typer.main.get_command)
