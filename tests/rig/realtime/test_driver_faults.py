"""Runs with a driver of another package that is slow, or gives wrong times: the run names card and call."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import runs
from runs.records import Status
from runs.run import Run
from tests.support.box_bench import ROOT, site

__all__ = ["site"]

pytestmark = pytest.mark.realtime

PROTOCOL = """
title: A climb
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1.5, shape: smooth}
  - hold: {duration_s: 1.5}
"""


def ran(folder: Path, fault: str) -> tuple[int, str, Run]:
    """Exit status, output and archive of a run with the example driver and this fault."""
    text = (ROOT / "docs" / "examples" / "driver-package" / "pneubox.yaml").read_text()
    device = f"faulty-{os.getpid()}-{folder.name}"
    card = f"  daq: {{driver: breakable, device: {device}, silence_ms: 1000, fault: '{fault}', inputs: 8, outputs: 8}}"
    old = next(line for line in text.splitlines() if line.startswith("  daq: {"))
    limits = "limits:\n  hung_s: 1.0\n"
    rig_file, protocol = folder / "box.yaml", folder / "climb.yaml"
    rig_file.write_text(text.replace(old, card).replace("limits:\n", limits).replace("stale_s: 0.1", "stale_s: 0.9"))
    protocol.write_text(PROTOCOL)
    sys.modules["softrig_pneubox"].power_up(device)
    command = [sys.executable, "-m", "rig", "run", str(protocol), "--rig", str(rig_file), "--yes", "--no-report"]
    done = subprocess.run([*command, "--out", str(folder / "out")], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr, runs.open(next((folder / "out").glob("*.h5")))


@pytest.fixture
def box(site: Path) -> None:
    """The drivers, installed and loaded."""
    __import__("softrig_pneubox")


@pytest.mark.usefixtures("box")
@pytest.mark.parametrize("call", ["read", "write"])
def test_a_slow_driver_is_named_with_the_call_that_is_slow(tmp_path: Path, call: str) -> None:
    status, said, archive = ran(tmp_path, f"slow {call}")
    assert status == 0, said
    (told,) = {event.message for event in archive.events if "deadlines are missed" in event.message}
    assert f"`{call}` of the driver of card daq takes" in told
    assert "too busy" not in told
    assert archive.timing.counters["slow_driver_calls"] > 10


@pytest.mark.usefixtures("box")
def test_scan_times_of_another_clock_end_the_run_in_the_safe_state_with_a_readable_archive(tmp_path: Path) -> None:
    status, said, archive = ran(tmp_path, "wall clock later")
    assert status == 1, said
    assert archive.status is Status.ABORTED
    assert "card daq: its newest scan is" in archive.message
    assert "CLOCK_MONOTONIC" in archive.message
    assert len(archive.pressure.time_s) > 50
    assert archive.pressure.time_s.max() < 60


@pytest.mark.usefixtures("box")
def test_scans_that_come_twice_are_a_warning(tmp_path: Path) -> None:
    status, said, archive = ran(tmp_path, "delivers twice")
    assert status == 0, said
    assert any("scans came twice from the driver" in event.message for event in archive.events)
    assert archive.timing.counters["repeated_scans"] > 100
