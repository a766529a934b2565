"""Drawing of a report's figures in two processes."""

from __future__ import annotations

import multiprocessing
import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import zip_longest
from multiprocessing.connection import Connection

Draw = Callable[[], str]


def drawn(figures: Sequence[Draw]) -> list[str]:
    """Return the results of functions that draw a figure, in their order; a second processor draws every other one.

    The child is forked, so that it has what the figures show. If it fails, this process draws its part, too, and
    raises the error.
    """
    # Windows cannot fork, and on macOS a forked process must not draw; neither has this function.
    if len(figures) < 2 or not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2:
        return [draw() for draw in figures]
    fork = multiprocessing.get_context("fork")
    received, sent = fork.Pipe(duplex=False)
    child = fork.Process(target=_draw, args=(figures[1::2], sent), daemon=True)
    with warnings.catch_warnings():
        # Python warns of every fork beside other threads; no figure waits for one.
        warnings.simplefilter("ignore", DeprecationWarning)
        child.start()
    sent.close()
    try:
        even, odd = [draw() for draw in figures[::2]], []
        with suppress(EOFError, OSError):
            odd = received.recv()
    finally:
        child.kill()
        child.join()
        received.close()
    odd = odd or [draw() for draw in figures[1::2]]
    return [drawing for pair in zip_longest(even, odd) for drawing in pair if drawing is not None]


def _draw(figures: Sequence[Draw], results: Connection) -> None:
    with suppress(Exception):
        results.send([draw() for draw in figures])
