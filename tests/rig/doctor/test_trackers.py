"""`rig doctor`, `rig drivers` and `rig test-driver` know trackers."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from rig.config import loader
from rig.conformance import source_checks
from rig.conformance.runner import conformance
from rig.conformance.source_checks import TRACKER_CHECKS, SourceSubject
from rig.doctor.devices import rig_devices
from rig.hardware.installed_drivers import installed_drivers
from tests.rig.hardware.test_udp_tracker import free_port
from tests.rig.realtime.test_tracker import example, udp_rig


def test_the_doctor_hears_a_sender_and_says_how_well_times_are_known(tmp_path: Path) -> None:
    port = free_port()
    with example(port):
        (finding,) = rig_devices(loader.load(udp_rig(tmp_path, port)))
    assert finding.verdict == "ok", finding
    assert f"poses at UDP 127.0.0.1:{port}" in finding.found


def test_the_doctor_names_a_sender_that_is_not_heard(tmp_path: Path) -> None:
    (finding,) = rig_devices(loader.load(udp_rig(tmp_path, free_port())))
    assert finding.verdict == "missing"
    assert "must come from 127.0.0.1" in finding.remedy


def test_the_shipped_trackers_are_listed() -> None:
    assert {row.name for row in installed_drivers() if row.kind == "trackers"} == {"udp", "mock"}


@pytest.mark.realtime
def test_the_mock_tracker_conforms() -> None:
    rig_file = loader.path_of("mock-tracker")
    with conformance(loader.load(rig_file), rig_file) as checks:
        results = [checks.run("tracker", "pose", check) for check in TRACKER_CHECKS]
    assert [(result.check, result.found) for result in results if result.failed] == []


class Patient:
    """A tracker that waits for its next reading whatever the time-out is."""

    def read(self, timeout_s: float) -> None:
        time.sleep(0.02)

    def close(self) -> None:
        """Nothing is open."""


def test_a_tracker_that_waits_in_spite_of_its_time_out_does_not_conform(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_checks, "open_tracker", lambda *_: Patient())
    check = next(check for check in TRACKER_CHECKS if check.name == "time-outs")
    result = check.result("tracker pose", SourceSubject(loader.load("mock-tracker"), "pose"))
    assert result.failed
    assert "waits for a reading" in result.found
