"""Frame sets in place of those of cameras: the readings of a tracker, or the times of the model's predictions."""

from __future__ import annotations

import time

import numpy as np

from rig.config.schema import RigConfig
from rig.hardware.cameras.base import FrameSet
from rig.hardware.driver_calls import as_error, release
from rig.hardware.trackers.base import TrackerError, TrackerReading, open_tracker
from runs.records import DATAGRAM_COUNTS

_MOST_SKIPPED = 1000


class ReadingSequence:
    """Frame sets of one tracker in increasing order of time, without a clock; one without a message has no reading.

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


class TrackerSource:
    """Gives the readings of the rig's tracker as frame sets in real time."""

    def __init__(self, config: RigConfig, seed: int) -> None:
        """Open the tracker. Raises TrackerError: it cannot be opened."""
        self._config = config
        self._name = next(iter(config.trackers))
        self._tracker = open_tracker(config, self._name, seed)
        self._sequence: ReadingSequence | None = None

    def await_all(self, timeout_s: float) -> None:
        """Wait for the first pose, which needs the sender's clock. Raises TrackerError: there is none."""
        reading = self._read(timeout_s)
        if reading is None:
            raise self._silence(timeout_s)
        self._sequence = ReadingSequence(self._config, reading.t_ns)

    def read(self, timeout_s: float) -> FrameSet:
        """Wait for the next frame set: a reading, or an empty one where the tracker is silent.

        Raises:
            TrackerError: the tracker was silent for `timeout_s`.
        """
        assert self._sequence is not None
        while True:
            reading = self._read(self._sequence.overdue_in_s(time.monotonic_ns()))
            now = time.monotonic_ns()
            if reading is not None:
                return self._sequence.take(self._newest(reading), now)
            if self._sequence.silent_s(now) > timeout_s:
                raise self._silence(timeout_s)
            empty = self._sequence.overdue(now)
            if empty is not None:
                self._tracker.pass_over(empty.t_ns)
                return empty

    def _read(self, timeout_s: float) -> TrackerReading | None:
        """Read the tracker. Raises TrackerError, also for an error in the driver's code or a wrong reading."""
        where = f"tracker {self._name}: read of its driver"
        with as_error(TrackerError, f"{where} failed"):
            reading = self._tracker.read(timeout_s)
            fault = "" if reading is None else _fault(reading)
        if fault:
            raise TrackerError(f"{where} returned {fault}")
        return reading

    def _newest(self, reading: TrackerReading) -> TrackerReading:
        """The newest reading that has arrived: as with pictures, a late reader leaves out those before it."""
        began_ns = time.monotonic_ns()
        for _ in range(_MOST_SKIPPED):
            # A driver that waits for a reading in spite of the time-out of 0 must not keep the reader here.
            if reading.t_ns >= began_ns:
                break
            newer = self._read(0.0)
            if newer is None:
                break
            reading = newer
        return reading

    def close(self) -> None:
        release((self._tracker,))

    def _silence(self, timeout_s: float) -> TrackerError:
        return silence(self._name, timeout_s, self._tracker.counts())


def _fault(reading: TrackerReading) -> str:
    """What is wrong with a reading; empty if nothing is."""
    for name, expected in (("position_m", (3,)), ("rotation", (3, 3)), ("covariance", (6, 6))):
        array = np.asarray(getattr(reading, name))
        if array.shape != expected:
            return f"{name} of shape {array.shape} instead of {expected}"
        if reading.seen and not np.isfinite(array).all():
            return f"a {name} that is not finite, of a pose that is seen"
    return ""


def silence(name: str, timeout_s: float, counts: tuple[int, ...]) -> TrackerError:
    """The error of a tracker that gave no pose for a time, with what it did receive."""
    unused = ", ".join(f"{n} {what.replace('_', ' ')}" for what, n in zip(DATAGRAM_COUNTS, counts, strict=True) if n)
    why = f"not used were {unused}" if unused else "nothing arrived: does the sender run, and send here?"
    return TrackerError(f"tracker {name}: no pose within {timeout_s:g} s; {why}")


class PredictionClock:
    """Gives an empty frame set per period of the model, in a rig without cameras and trackers."""

    def __init__(self, config: RigConfig) -> None:
        self._period_ns = round(1e9 / config.observation_hz)
        self._start_ns = time.monotonic_ns()
        self._period = self._count = 0

    def await_all(self, timeout_s: float) -> None:
        """Return at once: there is no camera to wait for."""

    def read(self, timeout_s: float) -> FrameSet:
        """Wait for the next period; periods that have passed meanwhile are left out, because no frame was lost."""
        passed = (time.monotonic_ns() - self._start_ns) // self._period_ns
        self._period = max(self._period, passed) + 1
        due_ns = self._start_ns + self._period * self._period_ns
        time.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
        self._count += 1
        return FrameSet(self._count, (), due_ns)

    def close(self) -> None:
        """Release nothing."""
