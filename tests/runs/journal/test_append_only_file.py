"""A stalled disk: a live run continues, its data are buffered in memory and written at the end."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import tests.support.synthetic_runs as made_up
from runs.journal import append_only_file, journal
from runs.journal.append_only_file import JournalError
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, Status

PATIENCE_S = 30.0


class Gate:
    """A call of the kernel that does not return while the gate is shut."""

    def __init__(self, call: Callable[..., int | None]) -> None:
        self._call = call
        self.reached = threading.Event()
        self.open = threading.Event()
        self.open.set()
        self.fault: OSError | None = None

    def __call__(self, *arguments: object) -> int | None:
        self.reached.set()
        assert self.open.wait(PATIENCE_S), "the gate was not opened"
        if self.fault is not None:
            raise self.fault
        return self._call(*arguments)

    def shut(self) -> None:
        self.open.clear()
        self.reached.clear()


@pytest.fixture
def writes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gate]:
    gate = Gate(os.write)
    monkeypatch.setattr(os, "write", gate)
    yield gate
    gate.open.set()


@pytest.fixture
def syncs(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gate]:
    gate = Gate(os.fdatasync)
    monkeypatch.setattr(os, "fdatasync", gate)
    monkeypatch.setattr(append_only_file, "SYNC_S", 0.01)
    yield gate
    gate.open.set()


@pytest.fixture
def writer(tmp_path: Path) -> JournalWriter:
    return JournalWriter(tmp_path / "a.mcap", made_up.header(), live=True)


FOOTER = RunFooter(made_up.START_NS, Status.FINISHED, "")
ROWS = made_up.samples(1.0)


def record(writer: JournalWriter) -> None:
    for low in range(0, len(ROWS), 20):
        writer.samples(ROWS[low : low + 20])


def record_for_ever(writer: JournalWriter) -> None:
    while True:
        record(writer)


def test_data_buffered_during_a_stall_are_written_afterwards(writer: JournalWriter, writes: Gate) -> None:
    writes.shut()
    record(writer)
    assert len(journal.read(writer.path).samples) == 0
    assert writer.stalled_s > 0
    writes.open.set()
    assert writer.wait_until_synced(PATIENCE_S)
    assert journal.read(writer.path).samples[:].tobytes() == ROWS.tobytes(), "before it is closed"
    assert writer.stalled_s == 0
    writer.close(FOOTER)
    content = journal.read(writer.path)
    assert content.footer == FOOTER
    assert content.samples[:].tobytes() == ROWS.tobytes()


def test_written_data_survive_a_stalled_sync(syncs: Gate, writer: JournalWriter) -> None:
    syncs.shut()
    assert syncs.reached.wait(PATIENCE_S)
    record(writer)
    assert journal.read(writer.path).samples[:].tobytes() == ROWS.tobytes()
    assert writer.stalled_s > 0
    assert not writer.wait_until_synced(0.01)
    syncs.open.set()
    writer.close(FOOTER)


def test_data_are_on_the_disk_only_after_a_sync_that_began_later(syncs: Gate, writer: JournalWriter) -> None:
    record(writer)
    syncs.shut()
    assert not writer.wait_until_synced(0.05)
    assert syncs.reached.wait(PATIENCE_S)
    syncs.open.set()
    assert writer.wait_until_synced(PATIENCE_S)
    writer.close(FOOTER)


def test_a_stalled_sync_alone_does_not_end_a_run(
    syncs: Gate, writer: JournalWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(append_only_file, "BUFFER_S", 0.0)
    syncs.shut()
    assert syncs.reached.wait(PATIENCE_S)
    record(writer)
    syncs.open.set()
    writer.close(FOOTER)


@pytest.mark.parametrize(("limit", "allowed"), [("BUFFER_S", 0.0), ("BUFFER_BYTES", 1000)])
def test_a_long_disk_stall_ends_the_run_without_data_loss(
    writer: JournalWriter, writes: Gate, monkeypatch: pytest.MonkeyPatch, limit: str, allowed: float
) -> None:
    monkeypatch.setattr(append_only_file, limit, allowed)
    writes.shut()
    with pytest.raises(JournalError, match=r"the disk with .*a\.mcap has taken nothing for .* s; .* MB wait in memory"):
        record(writer)
    writes.open.set()
    writer.close(FOOTER)
    content = journal.read(writer.path)
    assert content.footer == FOOTER
    assert content.samples[:].tobytes() == ROWS[:20].tobytes()


@pytest.mark.parametrize("failing", ["writes", "syncs"])
def test_an_asynchronous_error_is_raised_by_the_next_call(
    writes: Gate, syncs: Gate, writer: JournalWriter, failing: str
) -> None:
    gate = {"writes": writes, "syncs": syncs}[failing]
    gate.shut()
    gate.fault = OSError(errno.EIO, os.strerror(errno.EIO))
    writer.samples(ROWS[:20])
    assert gate.reached.wait(PATIENCE_S)
    gate.open.set()
    with pytest.raises(JournalError, match=r"cannot write .*Input/output error"):
        record_for_ever(writer)
    gate.fault = None
    with suppress(JournalError):  # syncs go on meanwhile, and one more of them may have failed
        writer.close(FOOTER)
    assert journal.read(writer.path).footer == FOOTER


def test_an_error_after_the_last_call_is_raised_by_close(writer: JournalWriter, writes: Gate) -> None:
    writes.shut()
    writer.samples(ROWS[:20])
    writes.fault = OSError(errno.EIO, os.strerror(errno.EIO))
    writes.open.set()
    assert writer.wait_until_synced(PATIENCE_S)
    writes.fault = None
    with pytest.raises(JournalError, match="Input/output error"):
        writer.close(FOOTER)
    assert journal.read(writer.path).footer == FOOTER


def test_the_journal_is_synced_every_second(syncs: Gate, writer: JournalWriter) -> None:
    for _ in range(3):
        syncs.reached.clear()
        assert syncs.reached.wait(PATIENCE_S)
    writer.close(FOOTER)


def test_a_disk_without_free_space_information_is_an_error(
    syncs: Gate, writer: JournalWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(_: int) -> os.statvfs_result:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as broken:
        broken.setattr(os, "fstatvfs", gone)
        with pytest.raises(JournalError, match="Input/output error"):
            record_for_ever(writer)
    with suppress(JournalError):
        writer.close(FOOTER)
