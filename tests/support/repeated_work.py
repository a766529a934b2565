"""Saves work that a process repeats if it runs many commands."""

from __future__ import annotations

import functools
import gc
import sys
from typing import Any


def avoid_repeated_work() -> None:
    """Do once what each command of a process does again.

    Exclude imported modules from garbage collection, build the command line once, and load the kernels of vision before
    the first virtual run: the processes that each run forks have them then. Each takes a tenth of the time. Call this
    after the imports. A process that has imported nothing of `rig` runs no command.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    if "rig" not in sys.modules:
        return
    import typer.main

    from rig.virtual.frame_pipeline import FramePipeline

    typer.main.get_command = functools.cache(typer.main.get_command)
    FramePipeline.__init__ = _after_loading(FramePipeline.__init__)  # type: ignore[method-assign]


def _after_loading(start: Any) -> Any:
    from rig.experiment.warm import measure_frames

    load = functools.cache(measure_frames)

    @functools.wraps(start)
    def started(*arguments: Any, **options: Any) -> None:
        load()
        start(*arguments, **options)

    return started
