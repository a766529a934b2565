"""Two cameras in real time: paired in the order of their times; the run continues without one."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config.loader import load
from rig.hardware.cameras import synchroniser
from rig.hardware.cameras.base import CameraError, Frame
from rig.hardware.cameras.synchroniser import CameraSynchroniser
from rig.simulator.faults import CameraFault
from runs.records import DetectionStatus, Status
from scripts.rig_process import rig_run
from tests.support.vision_bench import FRAME_NS

pytestmark = pytest.mark.realtime

HOLD = """
title: Two cameras, each lost for a while
steps:
  - ramp: {actuators: [1, 2, 3], to_bar: 0.3, duration_s: 1}
  - hold: {duration_s: 9}
"""


@dataclass
class Paced:
    """A camera whose pictures arrive late, or not at all between two times after the start."""

    start_ns: int
    late_ns: int = 0
    away_ns: tuple[int, int] = (0, 0)
    late_afterwards_ns: int = 0
    index: int = -1

    def read(self, timeout_s: float) -> Frame:
        """The next picture."""
        del timeout_s
        self.index += 1
        t_ns = self.index * FRAME_NS
        if self.away_ns[0] <= t_ns < self.away_ns[1]:
            time.sleep((self.away_ns[1] - t_ns) * 1e-9)
            self.index = self.away_ns[1] // FRAME_NS
            raise CameraError("away")
        late_ns = self.late_afterwards_ns if self.away_ns[1] and t_ns >= self.away_ns[1] else self.late_ns
        time.sleep(max(0.0, (self.start_ns + t_ns + late_ns - time.monotonic_ns()) * 1e-9))
        return Frame(self.index, self.start_ns + t_ns, np.zeros((2, 2), np.uint8))

    def close(self) -> None:
        """Nothing to release."""


def opened(monkeypatch: pytest.MonkeyPatch, left: Paced, right: Paced) -> CameraSynchroniser:
    cameras = {"left": left, "right": right}
    monkeypatch.setattr(synchroniser, "open_camera", lambda config, name, seed: cameras[name])
    return CameraSynchroniser(load("mock-stereo"), 0)


def test_softrig_waits_for_a_camera_whose_pictures_arrive_later(monkeypatch: pytest.MonkeyPatch) -> None:
    start_ns = time.monotonic_ns()
    cameras = opened(monkeypatch, Paced(start_ns), Paced(start_ns, late_ns=33_000_000))
    try:
        frame_sets = [cameras.read(1.0) for _ in range(20)]
    finally:
        cameras.close()
    assert np.mean([frame_set.frames[1] is not None for frame_set in frame_sets]) > 0.6
    assert np.all(np.diff([frame_set.t_ns for frame_set in frame_sets]) > 0)


def test_old_pictures_of_a_returning_camera_do_not_turn_the_time_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    start_ns = time.monotonic_ns()
    away = Paced(start_ns, away_ns=(400_000_000, 700_000_000), late_afterwards_ns=150_000_000)
    cameras = opened(monkeypatch, away, Paced(start_ns))
    try:
        frame_sets = [cameras.read(1.0) for _ in range(40)]
    finally:
        cameras.close()
    assert {frame_set.leader for frame_set in frame_sets} == {0, 1}
    assert np.all(np.diff([frame_set.t_ns for frame_set in frame_sets]) > 0)
    assert np.all(np.diff([frame_set.index for frame_set in frame_sets]) > 0)


def test_a_process_that_stalled_does_not_blame_its_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    start_ns = time.monotonic_ns()
    cameras = opened(monkeypatch, Paced(start_ns), Paced(start_ns))
    try:
        before = cameras.read(1.0)
        with cameras._changed:
            # The lock is held: no picture is taken in.
            time.sleep(1.2)
            after = cameras.read(1.0)
        assert after.t_ns > before.t_ns
    finally:
        cameras.close()


def test_a_run_continues_without_either_camera_and_reports_it(tmp_path: Path) -> None:
    with rig_run(tmp_path, HOLD, like="mock-stereo") as run:
        run.wait_until_pressurised()
        for number in (1, 2):
            run.card.faults.inject(camera=CameraFault.SILENT, camera_number=number)
            time.sleep(1.5)
            run.card.faults.clear()
            time.sleep(2.0)
        assert run.end() == 0, run.output
    archive = runs.open(run.archive())
    assert archive.status is Status.FINISHED
    said = " ".join(event.message for event in archive.events)
    for name in ("left", "right"):
        assert f"camera {name} gives no pictures; the tip is measured without it" in said
    tip = archive.tip
    assert np.all(np.diff(tip.time_s) > 0)
    alone = tip.camera_seen == DetectionStatus.NO_FRAME
    assert np.all(alone.sum(axis=0) > 5)
    assert np.mean(tip.seen == DetectionStatus.MEASURED) > 0.8
    both = ~alone.any(axis=1)
    assert both.sum() > 50
    period_us = FRAME_NS * 1e-3
    assert np.all(np.abs(tip.camera_skew_us[both, 1]) <= period_us / 2)
