"""Every fault of virtual time ends safe, is reported, and leaves an archive with the right status."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

import runs
from scripts.faults import virtual
from scripts.faults.catalogue import CATALOGUE, Fault
from scripts.faults.fault_trial import EARLIEST_S, PROTOCOL

FAULTS = [fault for fault in CATALOGUE if fault.virtual]
LATEST_S = 1.2
BRIEFER = PROTOCOL.replace("{moving_s:g}", "3.4")
"""Shorter than the campaign's protocol, because the faults come earlier."""


@pytest.fixture(autouse=True)
def briefer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the shorter protocol."""
    assert BRIEFER != PROTOCOL
    monkeypatch.setattr(virtual, "PROTOCOL", BRIEFER)


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_the_fault_is_reported_and_the_bench_is_safe(fault: Fault, tmp_path: Path) -> None:
    moment = random.Random(fault.name).uniform(EARLIEST_S, LATEST_S)
    trial = virtual.trial(fault, tmp_path, moment, seed=1)
    if trial.skipped:
        pytest.skip(trial.skipped)
    assert trial.wrong == ""


def test_the_catalogue_names_at_least_thirty_faults_once_each() -> None:
    names = [fault.name for fault in CATALOGUE]
    assert len(set(names)) == len(names) >= 30


def test_a_valve_that_does_not_obey_is_reported_when_the_air_does_not_leave(tmp_path: Path) -> None:
    (stuck,) = (fault for fault in FAULTS if fault.name == "both valves stuck open")
    out = tmp_path / "out"
    virtual.trial(stuck, tmp_path, 1.0, seed=1)
    (archive,) = out.glob("*.h5")
    assert "shut the air off by hand" in runs.open(archive).message
