"""`rig live` from another shell: a page attached to a run that goes already, a run that adapts among them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import runs
from runs.records import DetectionStatus, Status
from scripts.live_client import Stream, printed_link, request
from scripts.rig_process import RigProcess, rig_run

HELD = """
title: Something to find under way
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}
  - hold: {duration_s: 100}
"""
MOST_PACKETS = 50
PATIENCE_S = 60.0


@contextmanager
def attached(run: RigProcess, log: Path) -> Iterator[Stream]:
    """A `rig live` of its own, given nothing but the run's process; a viewer of its page."""
    command = [sys.executable, "-m", "rig", "live", "--pid", str(run.process.pid), "--port", "0"]
    with log.open("w") as file:
        live = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        url = printed_link(log.read_text, "live page")
        request(url)
        with Stream(url) as stream:
            yield stream
    finally:
        live.terminate()
        live.wait(PATIENCE_S)


@pytest.mark.realtime
def test_a_page_can_attach_and_leave_during_an_adapting_run(tmp_path: Path) -> None:
    with rig_run(tmp_path, HELD, "--adapt", "--free", "law,rpe_per_bar") as run:
        run.wait_until_pressurised()
        with attached(run, tmp_path / "first.log") as stream:
            first = stream.until("running")
            # Two packets may show one frame: the first may come before the picture of its frame.
            packets = (stream.packet()[0]["now"] for _ in range(MOST_PACKETS))
            later = next(now for now in packets if now["tip"]["frame"] > first["tip"]["frame"])
        assert run.process.poll() is None, "the run ended with the page"
        with attached(run, tmp_path / "second.log") as stream:
            last = stream.until("running")
            assert last["tip"]["frame"] > later["tip"]["frame"]
            stream.act("stop")
            run.wait_until_safe(10.0)
            assert run.end() == 130, run.output
    archive = runs.open(run.archive())
    assert archive.status is Status.INTERRUPTED
    assert "(live page)" in next(event.message for event in archive.events if event.source == "operator")
    adaptation = archive.adaptation
    assert adaptation is not None
    assert [row[0] for row in last["estimates"]] == list(adaptation.parameter)
    # Beside the run, in real time: the estimator has worked on every picture that vision has.
    measured = archive.tip.frame[archive.tip.seen == DetectionStatus.MEASURED]
    assert set(measured.tolist()) <= set(adaptation.frame.tolist())
    shown = [float(row[2]) for row in last["estimates"]]
    assert np.isclose(adaptation.value, shown, rtol=1e-4, atol=0).all(axis=1).any()


def test_without_a_running_experiment_there_is_one_sentence() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rig", "live", "--pid", "1", "--port", "0"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "process 1 runs no experiment of yours" in done.stderr
    assert "Traceback" not in done.stderr
