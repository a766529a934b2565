"""A real-time run on a stalled disk continues, reports the stall, and records everything."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import runs
from rig.execution.plan import NullOperator, OpenRecord, OperatorInterface, RunPlan
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import PreparedRun, prepare
from rig.realtime import health_monitor, supervisor
from rig.realtime.data_recorder import DataRecorder
from rig.realtime.shared_state import Stage
from runs.records import Event, Level, RunFooter, Status

PATIENCE_S = 30.0


class Listener(NullOperator):
    """Stores reported messages, and resumes the disk once the awaited one is reported."""

    def __init__(self, disk: threading.Event, awaited: str) -> None:
        self.reported: list[str] = []
        self._disk, self._awaited = disk, awaited

    def report(self, event: Event) -> None:
        self.reported.append(event.message)
        if self._awaited in event.message:
            self._disk.set()


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """A disk that takes data only while this event is set."""
    takes, write = threading.Event(), os.write

    def waiting(file: int, data: bytes) -> int:
        assert takes.wait(PATIENCE_S), "the disk was never resumed"
        return write(file, data)

    takes.set()
    monkeypatch.setattr(os, "write", waiting)
    yield takes
    takes.set()


@pytest.fixture
def prepared(tmp_path: Path) -> PreparedRun:
    return prepare("ramp-a", "mock", RunOptions(out=tmp_path, report=False))


def test_waiting_for_the_disk_is_reported_and_the_archive_is_complete(
    prepared: PreparedRun, disk: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended_on_a_stalled_disk(plan: RunPlan, open_record: OpenRecord, operator: OperatorInterface) -> RunFooter:
        record = open_record(time.monotonic_ns())
        disk.clear()
        record.event(Event(time.monotonic_ns(), Level.INFO, "control", "the valves are in their safe state"))
        return RunFooter(time.monotonic_ns(), Status.FINISHED, "")

    monkeypatch.setattr(supervisor, "run", ended_on_a_stalled_disk)
    monkeypatch.setattr(experiment, "DISK_WARNING_AFTER_S", 0.0)
    listener = Listener(disk, "waiting for the disk")
    result = experiment.run(prepared, listener)
    assert result.archive is not None
    assert listener.reported == [f"waiting for the disk to take the rest of {result.archive.with_suffix('.mcap')}"]
    archive = runs.open(result.archive)
    assert archive.status is Status.FINISHED
    assert [event.message for event in archive.events] == ["the valves are in their safe state"]


def test_the_supervisor_warns_of_a_stalled_disk_and_continues(
    prepared: PreparedRun, disk: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health_monitor, "DISK_S", 0.0)
    listener = Listener(disk, "has not taken the record")

    def supervised(plan: RunPlan, open_record: OpenRecord, operator: OperatorInterface) -> RunFooter:
        parent = supervisor.Supervisor(plan, operator, None)
        journal = open_record(time.monotonic_ns())
        parent.record = DataRecorder(plan, parent.memory, journal, operator)
        disk.clear()
        journal.event(Event(time.monotonic_ns(), Level.INFO, "control", "armed"))
        parent.memory.publish_stage("control", Stage.DONE)
        status, message = parent.supervise()
        os.close(parent.memory.fd)
        return RunFooter(time.monotonic_ns(), status, message)

    monkeypatch.setattr(supervisor, "run", supervised)
    result = experiment.run(prepared, listener)
    assert result.outcome.status is Status.FINISHED
    assert result.archive is not None
    events = runs.open(result.archive).events
    assert [event.level for event in events] == [Level.INFO, Level.WARNING]
    assert events[1].message in listener.reported
    assert "has not taken the record" in events[1].message
