"""`rig doctor` on a rig with an NI-DAQmx device: the package, NI's driver and the device, each where it is missing."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from rig.config import loader
from rig.config.drivers import Finding
from rig.doctor.devices import rig_devices
from tests.rig.hardware.test_nidaqmx_card import device, stand_in
from tests.support.command_line import status_of

__all__ = ["device", "stand_in"]


def nidaq_rig(folder: Path, device: str = "Dev1", outputs: int = 2) -> Path:
    """The rig of two flow valves with an NI-DAQmx device."""
    text = loader.text("pci1716")
    card = next(line for line in text.splitlines() if line.strip().startswith("daq:"))
    path = folder / "nidaq.yaml"
    path.write_text(text.replace(card, f"  daq: {{driver: nidaqmx, device: {device}, inputs: 16, outputs: {outputs}}}"))
    return path


def examined(path: Path) -> Finding:
    """What the check of the device finds."""
    (found,) = [finding for finding in rig_devices(loader.load(path)) if finding.topic == "rig's card daq"]
    return found


def test_the_doctor_names_a_package_that_is_not_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    assert status_of("doctor", "--rig", nidaq_rig(tmp_path), "--json") == 1
    rows = json.loads(capsys.readouterr().out)
    (found,) = [row for row in rows if row["topic"] == "rig's card daq"]
    assert found["verdict"] == "missing"
    assert "nidaqmx is not installed" in found["found"]
    assert "pip install 'softrig[nidaqmx]'" in found["remedy"]
    assert "NI's driver" in found["remedy"]


def test_the_doctor_names_nis_driver_where_only_the_package_is_installed(tmp_path: Path) -> None:
    pytest.importorskip("nidaqmx", reason="NI's package is not installed: pip install nidaqmx")
    found = examined(nidaq_rig(tmp_path))
    assert found.verdict == "missing"
    assert "NI's driver NI-DAQmx is not" in found.found
    assert "ni.com" in found.remedy


def test_the_doctor_finds_the_device_with_the_channels_of_the_rig(
    device: str, stand_in: ModuleType, tmp_path: Path
) -> None:
    found = examined(nidaq_rig(tmp_path, device))
    assert (found.verdict, found.found[:13]) == ("ok", "NI-DAQmx 24.5")


def test_the_doctor_names_a_device_that_is_not_there(stand_in: ModuleType, tmp_path: Path) -> None:
    found = examined(nidaq_rig(tmp_path, "Dev7"))
    assert found.verdict == "missing"
    assert "Dev7" in found.found
    assert "NI MAX" in found.remedy
