"""A run in real time whose tip comes over UDP from the example of the docs, and what happens once that falls silent."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import yaml

import runs
from rig.config import loader
from runs.records import DetectionStatus, Status
from scripts.rig_process import rig_run
from tests.rig.hardware.test_udp_tracker import free_port

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "send_pose.py"
SHORT = "title: Short\nsteps:\n  - ramp: {actuators: [1], to_bar: 0.2, duration_s: 1}\n  - hold: {duration_s: 1}\n"
LONG = SHORT.replace("duration_s: 1}\n", "duration_s: 60}\n").replace(
    "to_bar: 0.2, duration_s: 60", "to_bar: 0.2, duration_s: 1"
)
CIRCLE = resources.files("protocols").joinpath("library", "tip-circle.yaml").read_text(encoding="utf-8")
_MOCK = "pose: {driver: mock, rate_hz: 100, delay_ms: 2, delay_std_ms: 0.2, drift_ppm: 50, jitter_ms: 1}"


def udp_rig(folder: Path, port: int) -> str:
    """A rig with a simulated card and a tracker that listens at a port."""
    text = loader.text("mock-tracker")
    assert _MOCK in text
    path = folder / "udp.yaml"
    path.write_text(text.replace(_MOCK, f"pose: {{driver: udp, port: {port}, rate_hz: 100}}"))
    return str(path)


def three_valves(folder: Path, port: int) -> str:
    """The rig of `udp_rig` with a valve for each actuator, so that its tip can be controlled."""
    path = Path(udp_rig(folder, port))
    data, like = yaml.safe_load(path.read_text()), yaml.safe_load(loader.text("mock-3"))
    data |= {key: like[key] for key in ("cards", "valves", "tip_control")}
    text = yaml.safe_dump(data, sort_keys=False, width=1000, default_flow_style=None)
    path.write_text(text)
    return str(path)


@contextmanager
def example(port: int) -> Iterator[subprocess.Popen[bytes]]:
    """The example sender, running."""
    process = subprocess.Popen([sys.executable, str(EXAMPLE), str(port)])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.realtime
def test_the_example_sender_measures_the_tip_of_a_run(tmp_path: Path) -> None:
    port = free_port()
    with example(port), rig_run(tmp_path, SHORT, like=udp_rig(tmp_path, port), supervised=False) as run:
        assert run.end() == 0, run.output
        archive = runs.open(run.archive())
    assert archive.status is Status.FINISHED
    measured = archive.tip.seen == DetectionStatus.MEASURED
    assert np.count_nonzero(measured) > 100
    radius_mm = np.hypot(*archive.tip.measured_mm[measured, :2].T)
    assert radius_mm == pytest.approx(20, abs=1e-3)
    clock = archive.tracker
    assert clock is not None
    # Both clocks count the same nanoseconds: only the delay through the socket is left.
    assert np.all(np.abs(np.diff(clock.clock_offset_s[measured])) < 5e-3)
    assert np.all(np.abs(clock.clock_drift_ppm[measured]) <= 200)


@pytest.mark.realtime
def test_a_run_whose_tracker_falls_silent_ends_in_the_safe_state(tmp_path: Path) -> None:
    port = free_port()
    with (
        example(port) as sender,
        rig_run(tmp_path, LONG, like=udp_rig(tmp_path, port), supervised=False) as run,
    ):
        run.wait_until_pressurised()
        sender.kill()
        run.wait_until_safe(20.0)
        assert run.end() == 1
        archive = runs.open(run.archive())
    assert archive.status is Status.ABORTED
    assert "tracker pose: no pose within 1 s" in archive.message
    assert archive.tip.seen[-1] == DetectionStatus.NO_MESSAGE


@pytest.mark.realtime
def test_a_second_sender_is_a_warning_with_its_address(tmp_path: Path) -> None:
    port = free_port()
    with (
        example(port),
        rig_run(tmp_path, SHORT, like=udp_rig(tmp_path, port), supervised=False) as run,
    ):
        run.wait_until_started()
        with example(port):
            assert run.end() == 0, run.output
        archive = runs.open(run.archive())
    assert archive.status is Status.FINISHED
    assert [event.message for event in archive.events if "another program, at 127.0.0.1" in event.message]


@pytest.mark.realtime
def test_a_second_sender_ends_a_run_that_controls_the_tip(tmp_path: Path) -> None:
    port = free_port()
    with (
        example(port),
        rig_run(
            tmp_path, CIRCLE, "--controller", "inverse-integral", like=three_valves(tmp_path, port), supervised=False
        ) as run,
    ):
        run.wait_until_pressurised()
        with example(port):
            run.wait_until_safe(20.0)
        assert run.end() == 1
        archive = runs.open(run.archive())
    assert archive.status is Status.ABORTED
    assert "the tip is controlled and another program, at 127.0.0.1, sends poses" in archive.message


@pytest.mark.realtime
def test_a_run_whose_tracker_never_sends_does_not_start(tmp_path: Path) -> None:
    with rig_run(tmp_path, SHORT, like=udp_rig(tmp_path, free_port()), supervised=False) as run:
        assert run.end() == 1
        assert "nothing arrived: does the sender run" in " ".join(run.output.split())
