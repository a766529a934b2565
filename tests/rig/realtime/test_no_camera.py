"""A rig without cameras in real time: the model has its own rate, the page shows it, a lost observer ends the run."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config.loader import load
from rig.observation.frame_sources import PredictionClock
from runs.records import DetectionStatus, Status
from scripts.rig_process import rig_run
from tests.rig.live.test_attaching import HELD, attached


def test_predictions_are_numbered_without_gaps_at_even_times_also_after_a_stall() -> None:
    clock = PredictionClock(load("mock-no-camera"))
    before = clock.read(1.0)
    time.sleep(0.12)
    after = [clock.read(1.0) for _ in range(2)]
    period_ns = round(1e9 / 30)
    steps_ns = np.diff([before.t_ns, *(one.t_ns for one in after)])
    assert [one.index for one in (before, *after)] == [1, 2, 3]
    assert (steps_ns % period_ns == 0).all()
    assert steps_ns[0] >= 3 * period_ns
    assert after[1].frames == ()


@pytest.mark.realtime
def test_a_page_shows_a_run_without_a_camera_and_a_killed_observer_ends_the_run(tmp_path: Path) -> None:
    with rig_run(tmp_path, HELD, like="mock-no-camera") as run:
        run.wait_until_pressurised()
        with attached(run, tmp_path / "page.log") as stream:
            assert stream.about["measured"] is False
            stream.until("running")
            packets = [stream.packet() for _ in range(20)]
        lines = [body["overlay"]["lines"] for body, _ in packets if "overlay" in body]
        assert lines
        assert np.isfinite(np.array(lines[-1], float)).all()
        assert not any(picture for _, picture in packets)
        now = packets[-1][0]["now"]
        assert (now["tip"]["seen"], now["tip"]["error_mm"], "dropped" in now["timing"]) == ("no camera", None, False)
        os.kill(run.pid_of("rig.realtime.observer_process"), signal.SIGKILL)
        run.wait_until_safe(10.0)
        assert run.end() == 1, run.output
        archived = runs.open(run.archive())
    assert archived.status is Status.ABORTED
    assert (archived.tip.seen == DetectionStatus.NO_CAMERA).all()
    assert archived.tip.model_ok.all()
    assert "dropped_frames" not in archived.timing.counters
