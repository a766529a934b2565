"""Sequence of a tracker's readings as frame sets, with empty ones where the tracker is silent. It uses no clock."""

from __future__ import annotations

from rig.config.schema import RigConfig
from rig.hardware.cameras.base import FrameSet
from rig.hardware.trackers.base import TrackerReading


class ReadingSequence:
    """Frame sets of one tracker in increasing order of time; one that waits for no message has no reading.

    A time gets an empty frame set once every message of it would be late (`latest_ms`).
    """

    def __init__(self, config: RigConfig, start_ns: int) -> None:
        tracker = config.tracker
        assert tracker is not None
        self._period_ns = round(1e9 / tracker.rate_hz)
        self._latest_ns = round(tracker.latest_ms * 1e6)
        self._newest_ns, self._heard_ns = start_ns, start_ns
        self._index = self._number = -1
        self._empty = 0

    def take(self, reading: TrackerReading, now_ns: int) -> FrameSet:
        """The frame set of a reading; messages that were lost without an empty frame set are gaps of the index."""
        lost = 0 if self._number < 0 else max(0, reading.index - self._number - 1 - self._empty)
        self._index += 1 + lost
        self._number, self._empty = reading.index, 0
        self._newest_ns, self._heard_ns = reading.t_ns, now_ns
        return FrameSet(self._index, (), reading.t_ns, reading)

    def overdue(self, now_ns: int) -> FrameSet | None:
        """The next empty frame set; None while its message can still come in time."""
        due_ns = self._newest_ns + self._period_ns
        if now_ns - due_ns <= self._latest_ns:
            return None
        self._index, self._empty, self._newest_ns = self._index + 1, self._empty + 1, due_ns
        return FrameSet(self._index, (), due_ns)

    def overdue_in_s(self, now_ns: int) -> float:
        """Time until the next empty frame set is due [s]."""
        return max(0, self._newest_ns + self._period_ns + self._latest_ns - now_ns) * 1e-9

    def silent_s(self, now_ns: int) -> float:
        """Time since the last reading [s]."""
        return (now_ns - self._heard_ns) * 1e-9
