"""`rig test-driver` with drivers that hang, crash or flood: a result always comes, and the outputs end safe."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rig.config import loader
from rig.conformance.card_checks import CARD_CHECKS
from rig.conformance.runner import conformance
from rig.conformance.timing import CheckTiming
from rig.hardware import runtime_folder
from rig.hardware.running import FOLDER
from tests.support.box_bench import box_rig, site
from tests.support.waiting import wait_until

__all__ = ["site"]

CHECKS = {check.name: check for check in CARD_CHECKS}
SHORT = CheckTiming(sample_s=0.25, freed_s=0.5, check_s=4.0)
OUTPUTS = 3


def outputs(rig_file: Path) -> list[float]:
    """What the outputs of the box are [V], as it stands in its memory; the box does nothing by itself before a call."""
    device = loader.load(rig_file).cards["daq"].device
    state = sys.modules["softrig_pneubox"].file_of(device)
    return [float(volts) for volts in np.fromfile(state, np.float64)[:OUTPUTS]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("check", "fault", "says"),
    [
        ("sampling", "hangs in read", "does not return within 4 s, in stuck (breakable_card.py"),
        ("sampling", "holds the interpreter in read", "does not return within 4 s, in stuck (breakable_card.py"),
        ("sampling", "loops in read", "does not return within 4 s"),
        ("sampling", "prints without end in read", "does not return within 4 s"),
        ("sampling", "returns scans without end", "more than 1000000 scans"),
        ("sampling", "fills the memory in read", "MemoryError"),
        ("sampling", "crashes in read", "its process ended by SIGSEGV"),
        ("sampling", "aborts in read", "its process ended by SIGABRT, in stuck (breakable_card.py"),
        ("sampling", "exits in read", "SystemExit: 0"),
        ("sampling", "exits at once in read", "its process ended with status 0"),
        ("sampling", "stops itself in read", "does not return within 4 s"),
        ("sampling", "kills its session in read", "its process ended by SIGKILL"),
        ("sampling", "hangs in start", "does not return within 4 s"),
        ("closing", "hangs in opening", "does not return within 4 s"),
        ("closing", "crashes in opening", "its process ended by SIGSEGV"),
    ],
)
def test_a_driver_that_ends_or_stops_its_process_fails_and_leaves_the_outputs_safe(
    site: Path, tmp_path: Path, check: str, fault: str, says: str
) -> None:
    rig_file = box_rig(tmp_path, "breakable", fault=f"'{fault}'")
    with conformance(loader.load(rig_file), rig_file, timing=SHORT) as checks:
        result = checks.run("card", "daq", CHECKS[check])
    assert result.failed
    assert says in result.found
    assert "shut the air off" not in result.found
    assert outputs(rig_file) == [0.0] * OUTPUTS


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault", ["hangs in write", "exits at once in write", "hangs in close", "hangs in any opening", "crashes in close"]
)
def test_a_driver_that_cannot_make_its_outputs_safe_either_says_that_the_air_must_be_shut_off(
    site: Path, tmp_path: Path, fault: str
) -> None:
    rig_file = box_rig(tmp_path, "breakable", fault=f"'{fault}'")
    with conformance(loader.load(rig_file), rig_file, timing=SHORT) as checks:
        result = checks.run("card", "daq", CHECKS["read-back"])
    assert result.failed
    assert "the safe state could not be written afterwards" in result.found
    assert result.found.endswith("shut the air off by hand")


@pytest.mark.slow
def test_a_thread_that_writes_on_after_closing_ends_with_its_check(site: Path, tmp_path: Path) -> None:
    rig_file = box_rig(tmp_path, "breakable", fault="'a thread writes on'")
    with conformance(loader.load(rig_file), rig_file, timing=SHORT) as checks:
        checks.run("card", "daq", CHECKS["read-back"])
    assert outputs(rig_file) == [0.0] * OUTPUTS


def test_driver(rig_file: Path, *options: str) -> subprocess.Popen[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "rig", "test-driver", str(rig_file), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


test_driver.__test__ = False  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_table_appears_and_names_what_was_not_run(site: Path, tmp_path: Path) -> None:
    rig_file = box_rig(tmp_path, "breakable", fault="'crashes in read'")
    command = test_driver(rig_file, "--json")
    said, _ = command.communicate(timeout=120)
    rows = {row["check"]: row["verdict"] for row in json.loads(said) if row["device"] == "card daq"}
    assert command.returncode == 1
    assert rows["sampling"] == rows["durations"] == "FAIL"
    assert rows["bad values"] == "pass"
    assert list(rows) == list(CHECKS)


@pytest.mark.slow
def test_a_device_that_cannot_be_opened_is_one_line(site: Path, tmp_path: Path) -> None:
    rig_file = box_rig(tmp_path, "pneubox")
    sys.modules["softrig_pneubox"].file_of(loader.load(rig_file).cards["daq"].device).unlink()
    command = test_driver(rig_file, "--json")
    said, _ = command.communicate(timeout=120)
    first, rest = [row for row in json.loads(said) if row["device"] == "card daq"]
    assert (first["verdict"], rest["verdict"], command.returncode) == ("FAIL", "skipped", 1)
    assert "switch it on" in first["found"]
    assert rest["found"] == "not run: the card cannot be opened"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_test_that_is_interrupted_ends_with_the_safe_state(
    site: Path, tmp_path: Path, number: signal.Signals
) -> None:
    rig_file = box_rig(tmp_path, "breakable", fault="'hangs in read'")
    command = test_driver(rig_file, "--json")
    # `sampling` hangs: it has written all outputs before.
    wait_until(lambda: min(outputs(rig_file)) > 0, "the outputs are driven")
    time.sleep(0.2)
    command.send_signal(number)
    said, _ = command.communicate(timeout=60)
    assert command.returncode == 130
    assert [row["found"] for row in json.loads(said)][-1] == "interrupted"
    assert outputs(rig_file) == [0.0] * OUTPUTS


@pytest.mark.slow
def test_after_sigkill_the_process_that_stands_by_makes_the_outputs_safe(site: Path, tmp_path: Path) -> None:
    rig_file = box_rig(tmp_path, "breakable", fault="'hangs in read'")
    command = test_driver(rig_file)
    wait_until(lambda: min(outputs(rig_file)) > 0, "the outputs are driven")
    os.kill(command.pid, signal.SIGKILL)
    wait_until(lambda: max(outputs(rig_file)) == 0, "the outputs are safe")
    command.communicate(timeout=20)
    # The record of a killed process stays, and `rig vent` would list it in every test to come.
    (record,) = runtime_folder.subfolder(FOLDER).glob(f"{command.pid}-*.json")
    record.unlink()
