"""Every fault of virtual time ends safe, is reported, and leaves an archive with the right status."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import pytest

import runs
from scripts.faults import virtual
from scripts.faults.__main__ import main
from scripts.faults.catalogue import CATALOGUE
from scripts.faults.fault import Fault, FaultRegistry
from scripts.faults.fault_trial import EARLIEST_S

pytestmark = pytest.mark.slow

LATEST_S = 1.2
MOVING_S = 2.6
"""Shorter than in the campaign, because the faults come earlier."""
FAULTS = [replace(fault, moving_s=MOVING_S) for fault in CATALOGUE.values() if fault.virtual]


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_the_fault_is_reported_and_the_bench_is_safe(fault: Fault, tmp_path: Path) -> None:
    moment = random.Random(fault.name).uniform(EARLIEST_S, LATEST_S)
    trial = virtual.trial(fault, tmp_path, moment, seed=1)
    if trial.skipped:
        pytest.skip(trial.skipped)
    assert trial.wrong == ""


def test_the_catalogue_names_at_least_thirty_faults_once_each() -> None:
    assert len(CATALOGUE) >= 30
    assert [fault.name for fault in CATALOGUE.values()] == list(CATALOGUE)
    with pytest.raises(ValueError, match="a fault named 'sensor open' is registered already"):
        FaultRegistry(CATALOGUE["sensor open"], CATALOGUE["sensor open"])


def test_an_unknown_fault_is_refused_with_the_known_names(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--only", "no such fault"])
    assert "no fault is named like 'no such fault'; known are: sensor open, sensor short" in capsys.readouterr().err


def test_a_valve_that_does_not_obey_is_reported_when_the_air_does_not_leave(tmp_path: Path) -> None:
    (stuck,) = (fault for fault in FAULTS if fault.name == "both valves stuck open")
    out = tmp_path / "out"
    virtual.trial(stuck, tmp_path, 1.0, seed=1)
    (archive,) = out.glob("*.h5")
    assert "shut the air off by hand" in runs.open(archive).message
