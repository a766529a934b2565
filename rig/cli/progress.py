"""Progress of long computations on standard error: a bar on a terminal, elsewhere a line every few seconds."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from rig.cli.output import console

# Slow and fast models alternate, so the remaining time needs an average over a long period.
_SPEED_PERIOD_S = 3600.0
LINE_PERIOD_S = 10.0


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show how many of a number of tasks are done; yield a function to call with (done, total)."""
    with _shown(what, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as (bar, line):
        job = bar.add_task(what, total=None)

        def update(done: int, total: int) -> None:
            bar.update(job, completed=done, total=total)
            line(f"{done} of {total}")

        yield update


@contextmanager
def state_of(what: str) -> Iterator[Callable[[str], None]]:
    """Show that a computation of unknown length runs, and for how long; yield a function to call with its state."""
    with _shown(what, BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}")) as (bar, line):
        job = bar.add_task("", total=None)

        def update(state: str) -> None:
            bar.update(job, description=state)
            line(state)

        yield update


@contextmanager
def _shown(what: str, *columns: ProgressColumn) -> Iterator[tuple[Progress, Callable[[str], None]]]:
    """Show a bar of these columns, or lines where there is no terminal."""
    screen = console(stderr=True)
    off = not screen.is_terminal
    bar = Progress(
        TextColumn(what), *columns, console=screen, transient=True, disable=off, speed_estimate_period=_SPEED_PERIOD_S
    )
    with bar, _lines(what, disable=screen.is_terminal) as line:
        yield bar, line


@contextmanager
def _lines(what: str, disable: bool) -> Iterator[Callable[[str], None]]:
    """Print elapsed time and the last state every few seconds, from a thread: one step may take longer."""
    if disable:
        yield lambda state: None
        return
    screen, began, over = console(stderr=True), time.monotonic(), threading.Event()
    last = ""

    def show(state: str) -> None:
        nonlocal last
        last = state

    def watch() -> None:
        while not over.wait(LINE_PERIOD_S):
            text = f"{what}: {time.monotonic() - began:.0f} s"
            screen.print(f"{text}, {last}" if last else text, soft_wrap=True)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield show
    finally:
        over.set()
        thread.join()
