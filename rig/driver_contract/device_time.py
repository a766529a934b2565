"""How long a call into a driver takes, without the time that this process waits for a processor."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")

_SCHEDULER = Path("/proc/thread-self/schedstat")


def timed(call: Callable[[], Result]) -> tuple[Result, float]:
    """The result of a call and its duration [s]: a busy computer is not the driver's fault.

    Where the system does not tell how long the thread waited for a processor, the whole duration.
    """
    waited_s, began = _waited_s(), time.monotonic()
    result = call()
    took_s = time.monotonic() - began
    return result, max(0.0, took_s - (_waited_s() - waited_s))


def _waited_s() -> float:
    """Time [s] that this thread was ready to run and did not."""
    try:
        return int(_SCHEDULER.read_text().split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return 0.0
