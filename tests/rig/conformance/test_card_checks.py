"""The conformance tests of card drivers: good drivers pass, and each check finds the driver that breaks it."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import pytest

from rig.config import loader
from rig.conformance.card_checks import CARD_CHECKS
from rig.conformance.card_subject import CardSubject
from rig.conformance.check import CheckResult, CheckVerdict
from rig.conformance.runner import Unplug, conformance
from rig.conformance.timing import CheckTiming
from rig.hardware.lock import lock_file
from scripts.pressure_controller import controller
from scripts.rig_process import write_rig
from tests.support.box_bench import box_rig, site
from tests.support.command_line import status_of
from tests.support.firmware import firmware

__all__ = ["site"]

pytest_plugins = ["rig.conformance.pytest_plugin"]

CHECKS = {check.name: check for check in CARD_CHECKS}
BUS_VALVE = "  - {{type: bus, actuators: [{}], card: daq, channel: {}, range_bar: [0, 1]}}\n"
BUS_SENSOR = "  - {{actuator: {}, card: daq, channel: {}, unit: bar, span_bar: [0, 1]}}\n"
SHORT = CheckTiming(sample_s=0.25)


@pytest.fixture
def driver_rig(site: Path, tmp_path: Path) -> Path:
    return box_rig(tmp_path, "pneubox")


@pytest.fixture
def driver_unplug(driver_rig: Path) -> Unplug:
    config = loader.load(driver_rig)
    box = importlib.import_module("softrig_pneubox")
    return lambda card: box.file_of(config.cards[card].device).unlink()


@pytest.fixture
def driver_timing() -> CheckTiming:
    return SHORT


@pytest.mark.realtime
def test_the_example_driver_conforms_by_the_fixtures(driver_check: CheckResult) -> None:
    assert driver_check.verdict is CheckVerdict.PASS, driver_check


@pytest.mark.realtime
def test_the_mock_card_conforms(tmp_path: Path) -> None:
    rig_file = write_rig(tmp_path)
    config = loader.load(rig_file)
    try:
        with conformance(config, rig_file, timing=SHORT) as checks:
            found = [checks.run("card", "daq", check) for check in CARD_CHECKS]
    finally:
        lock_file(config.cards["daq"]).unlink(missing_ok=True)
    expected = {check.name: CheckVerdict.PASS for check in CARD_CHECKS} | {"silence": CheckVerdict.SKIPPED}
    assert {result.check: result.verdict for result in found} == expected, found


@pytest.mark.realtime
def test_the_serial_driver_conforms(tmp_path: Path) -> None:
    with controller(firmware(tmp_path), tmp_path) as running:
        card = f"  daq: {{driver: serial, device: {running.device}, inputs: 4, outputs: 4}}\n"
        text = loader.text("pci1716")
        valves = "valves:\n" + "".join(BUS_VALVE.format(n + 1, n) for n in range(3)) + "\n"
        sensors = "sensors:\n" + "".join(BUS_SENSOR.format(n + 1, n) for n in range(3)) + "\n"
        rig_file = tmp_path / "rig.yaml"
        before, after = text[: text.index("  daq: {")], text[text.index("limits:\n") :]
        rig_file.write_text(f"{before}{card}\n{valves}{sensors}{after}")
        subject = CardSubject(loader.load(rig_file), "daq", rig_file, running.unplug, SHORT)
        found = [check.result("daq", subject) for check in CARD_CHECKS]
    # A new session knows no set-point, and the silence of the firmware is not in the section of the card.
    skipped = dict.fromkeys(("opening", "silence"), CheckVerdict.SKIPPED)
    expected = {check.name: CheckVerdict.PASS for check in CARD_CHECKS} | skipped
    assert {result.check: result.verdict for result in found} == expected, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("check", "fault", "says"),
    [
        ("opening", "opening drives", "closed and opened again: neither may write"),
        ("opening", "opening writes zero", "closed and opened again: neither may write"),
        ("opening", "closing writes zero", "closed and opened again: neither may write"),
        ("opening", "start writes zero", "opened again and started: neither may write"),
        ("read-back", "swaps outputs", "read back"),
        ("read-back", "frozen read-back", "read back"),
        ("read-back", "offset", "read back"),
        ("read-back", "drops the last output", "read back"),
        ("bad values", "takes NaN", "NaN was accepted"),
        ("bad values", "does not clip", "beyond range_V"),
        ("sampling", "wall clock", "is t_ns CLOCK_MONOTONIC?"),
        ("sampling", "repeated time", "do not increase"),
        ("sampling", "returns scans without end", "more than 1000000 scans"),
        ("sampling", "delivers twice", "do not increase"),
        ("sampling", "millivolts", "beyond the range of the input"),
        ("sampling", "one column", "shape"),
        ("sampling", "no scans", "0 scans"),
        ("sampling", "not a number", "not finite"),
        pytest.param("durations", "slow read", "read 3", marks=pytest.mark.realtime),
        pytest.param("durations", "slow write", "write 3", marks=pytest.mark.realtime),
        pytest.param("durations", "now and then a slow read", "calls of read take longer", marks=pytest.mark.realtime),
        ("second opener", "refuses the watchdog", "no second process, please"),
        ("second opener", "does not name the holder", "softrig cannot end it"),
        ("second opener", "raises an OSError", "OSError: device busy"),
        ("second opener", "second write is lost", "and reads back"),
        ("second opener", "echoes its own write", "the first process still reads"),
        ("second opener", "the second opener disconnects the first", "connection lost"),
        ("silence", "does not vent", "the driver states that it vents"),
        ("sampling", "late scans", "ms old at best"),
        ("pressures", "volts for a device in bar", "in which unit, to which channel?"),
        ("pressures", "writes and reads back in the wrong order", "to which channel?"),
        ("pressures", "swaps inputs", "to which channel?"),
        ("pressures", "writes nothing and reads back the last write", "reads 0.00 bar"),
        ("pressures", "a sensor is stuck at zero", "reads 0.00 bar"),
        ("vented", "a sensor is stuck", "actuator 2 at 0.60 bar"),
        ("closing", "the second close raises", "ValueError: already closed"),
        ("closing", "closing raises", "OSError: cable pulled"),
        ("killed owner", "stale lock", "the box is in use"),
        ("vanished device", "blind to a pulled cable", "scans still come"),
    ],
)
def test_each_check_finds_the_driver_that_breaks_it(
    site: Path, tmp_path: Path, check: str, fault: str, says: str
) -> None:
    # The box is asked before it vents by itself, also by a busy machine.
    keys = {"silence_ms": "1000"} if check == "opening" else {}
    rig_file = box_rig(tmp_path, "breakable", fault=f"'{fault}'", **keys)
    config = loader.load(rig_file)
    box = importlib.import_module("softrig_pneubox")
    device = config.cards["daq"].device
    timing = CheckTiming(
        sample_s=1.0 if fault == "now and then a slow read" else SHORT.sample_s,
        settled_s=0.05,
        pressurised_s=0.4,
        freed_s=0.1,
        gone_s=0.1,
    )
    subject = CardSubject(config, "daq", rig_file, lambda: box.file_of(device).unlink(), timing)
    result = CHECKS[check].result("daq", subject)
    box.file_of(device).unlink(missing_ok=True)
    assert result.failed
    assert says in result.found


def test_a_rig_without_the_channels_or_the_cable_skips_and_says_why(site: Path, tmp_path: Path) -> None:
    config = loader.load(box_rig(tmp_path, "pneubox"))
    subject = CardSubject(config, "daq", tmp_path / "rig.yaml", None, SHORT)
    result = CHECKS["vanished device"].result("daq", subject)
    assert (result.verdict, result.found) == (CheckVerdict.SKIPPED, "the device was not unplugged")


def test_outputs_of_a_real_card_are_not_moved_without_confirmation(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("test-driver", "pci1716") == 2
    assert "--supply-off" in capsys.readouterr().err


def test_the_command_prints_every_result_and_fails_for_a_broken_driver(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rig_file = box_rig(tmp_path, "breakable", fault="takes NaN")
    text = rig_file.read_text().replace("driver: opencv", "driver: absent")
    assert "absent" in text
    monkeypatch.setattr("rig.conformance.runner.CAMERA_CHECKS", ())
    monkeypatch.setattr("rig.conformance.runner.CARD_CHECKS", (CHECKS["read-back"], CHECKS["bad values"]))
    assert status_of("test-driver", rig_file, "--json") == 1
    rows = json.loads(capsys.readouterr().out)
    assert [(row["device"], row["check"], row["verdict"]) for row in rows] == [
        ("card daq", "read-back", "pass"),
        ("card daq", "bad values", "FAIL"),
    ]
