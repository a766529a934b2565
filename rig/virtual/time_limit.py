"""Time limit of a call into code of the user: a run in virtual time has no other process that could end it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

LONGEST_CALL_S = 60.0
"""Longest time of a call by the clock: far more than a step takes on a busy machine, so that it decides no result."""
WARM_UP_S = 600.0
"""Long, because a cold compiler cache on a busy machine is not a fault."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after so many seconds by the clock (SIGALRM).

    Signals reach the main thread only: in another thread there is no limit.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def expire(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"it did not return within {seconds:g} s")

    previous = signal.signal(signal.SIGALRM, expire)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)
