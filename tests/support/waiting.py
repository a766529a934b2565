"""Wait for what another process or thread does."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE_S = 30.0


def wait_until(condition: Callable[[], bool], what: str = "") -> None:
    """Return once the condition holds; fail with `what` if it does not for long."""
    limit = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < limit, f"timed out: {what}"
        time.sleep(0.002)
