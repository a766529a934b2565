"""Stalls of a control loop: for a while after one, its duration does not count against the bench."""

from __future__ import annotations

STALLED_NS = 20_000_000
EXCUSED_NS = 100_000_000
"""Time for a card or its simulator to deliver the scans of a stall of this process."""


class StallExcuse:
    """Remembers the last stall."""

    def __init__(self) -> None:
        self._stalled_ns = self._until_ns = 0

    def stalled_ns(self, now_ns: int, behind_ns: int) -> int:
        """Duration [ns] of a stall within the last EXCUSED_NS, 0 if there was none; `behind_ns`: the delay now."""
        if behind_ns > STALLED_NS:
            self._stalled_ns, self._until_ns = behind_ns, now_ns + EXCUSED_NS
        return self._stalled_ns if now_ns < self._until_ns else 0
