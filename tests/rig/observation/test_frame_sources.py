"""The tracker of a run in real time: a late reader gets the newest pose, and those before it count as dropped."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from rig.config import loader
from rig.hardware.trackers.base import ClockEstimate, TrackerError, TrackerReading
from rig.observation import frame_sources
from rig.observation.frame_sources import TrackerSource


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
    monkeypatch.setattr(frame_sources, "open_tracker", lambda *_: tracker)
    source = TrackerSource(loader.load("mock-tracker"), seed=0)
    source.await_all(1.0)
    source.read(1.0)
    assert tracker.reads == 3


def test_a_late_reader_takes_the_newest_pose_and_counts_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_sources, "open_tracker", lambda *_: Waiting(8))
    source = TrackerSource(loader.load("mock-tracker"), seed=0)
    source.await_all(1.0)
    first = source.read(1.0)
    assert first.reading is not None
    assert first.reading.index == 7


class Broken:
    """A tracker whose second reading breaks the contract."""

    def __init__(self, **broken: object) -> None:
        clock, now_ns = ClockEstimate(0.0, 0.0, 0.0), time.monotonic_ns()
        good = TrackerReading(0, now_ns, True, np.zeros(3), np.eye(3), np.eye(6), clock, 0.0)
        self._readings = [good, replace(good, index=1, t_ns=now_ns + 10**10, **broken)]  # type: ignore[arg-type]

    def read(self, timeout_s: float) -> TrackerReading | None:
        return self._readings.pop(0)


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        ({"position_m": np.zeros(2)}, r"position_m of shape \(2,\) instead of \(3,\)"),
        ({"covariance": np.eye(3)}, r"covariance of shape \(3, 3\) instead of \(6, 6\)"),
        ({"rotation": np.full((3, 3), np.nan)}, "a rotation that is not finite, of a pose that is seen"),
        ({"position_m": np.full(3, np.nan)}, "a position_m that is not finite, of a pose that is seen"),
    ],
)
def test_a_reading_that_breaks_the_contract_is_an_error_of_the_tracker(
    monkeypatch: pytest.MonkeyPatch, broken: dict[str, object], says: str
) -> None:
    monkeypatch.setattr(frame_sources, "open_tracker", lambda *_: Broken(**broken))
    source = TrackerSource(loader.load("mock-tracker"), seed=0)
    source.await_all(1.0)
    with pytest.raises(TrackerError, match=f"tracker pose: read of its driver returned {says}"):
        source.read(1.0)


def test_any_error_in_the_code_of_a_driver_is_an_error_of_its_tracker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_sources, "open_tracker", lambda *_: Waiting(0))
    monkeypatch.setattr(Waiting, "read", lambda self, timeout_s: {}["cable"])
    with pytest.raises(TrackerError, match="tracker pose: read of its driver failed: KeyError: 'cable'"):
        TrackerSource(loader.load("mock-tracker"), seed=0).await_all(1.0)
