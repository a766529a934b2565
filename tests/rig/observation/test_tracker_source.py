"""The tracker of a run in real time: a late reader gets the newest pose, and those before it count as dropped."""

from __future__ import annotations

import time

import numpy as np
import pytest

from rig.config import loader
from rig.hardware.trackers.base import ClockEstimate, TrackerReading
from rig.observation import tracker_source
from rig.observation.tracker_source import TrackerSource


class Waiting:
    """A tracker whose readings have all arrived."""

    def __init__(self, count: int) -> None:
        clock = ClockEstimate(0.0, 0.0, 0.0)
        self._readings = [
            TrackerReading(k, k * 10_000_000, True, np.zeros(3), np.eye(3), np.eye(6), clock, 0.0) for k in range(count)
        ]

    def read(self, timeout_s: float) -> TrackerReading | None:
        return self._readings.pop(0) if self._readings else None


class Patient:
    """A tracker that waits for its next reading whatever the time-out is."""

    def __init__(self) -> None:
        self.reads = 0

    def read(self, timeout_s: float) -> TrackerReading | None:
        self.reads += 1
        time.sleep(0.002)
        clock = ClockEstimate(0.0, 0.0, 0.0)
        return TrackerReading(self.reads, time.monotonic_ns(), True, np.zeros(3), np.eye(3), np.eye(6), clock, 0.0)


def test_a_driver_that_waits_in_spite_of_its_time_out_does_not_keep_the_reader(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracker = Patient()
    monkeypatch.setattr(tracker_source, "open_tracker", lambda *_: tracker)
    source = TrackerSource(loader.load("mock-tracker"), seed=0)
    source.await_all(1.0)
    source.read(1.0)
    assert tracker.reads == 3


def test_a_late_reader_takes_the_newest_pose_and_counts_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker_source, "open_tracker", lambda *_: Waiting(8))
    source = TrackerSource(loader.load("mock-tracker"), seed=0)
    source.await_all(1.0)
    first = source.read(1.0)
    assert first.reading is not None
    assert first.reading.index == 7
