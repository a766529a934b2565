"""The journal: what was written is there, whatever happens to the process, the disk or the file."""

from __future__ import annotations

import dataclasses
import errno
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from mcap.reader import make_reader
from numpy.typing import NDArray

import tests.support.synthetic_runs as made_up
from runs.archive.writer import ArchiveInUseError, locked
from runs.journal import append_only_file, journal, messages, row_kinds
from runs.journal.append_only_file import JournalError, JournalFullError
from runs.journal.journal import JournalWriter
from runs.records import Event, Level, RunFooter, RunHeader, Status, sample_dtype
from tests.support.budget import examples

WRITER = """
import sys
sys.path.insert(0, {tests!r})
from tests.support import synthetic_runs as made_up
from runs.journal.journal import JournalWriter
rows = made_up.samples(500.0)
writer = JournalWriter(sys.argv[1], made_up.header(), live={live})
for low in range(0, len(rows), 5):
    writer.samples(rows[low : low + 5])
    writer.picture(made_up.picture(low))
    sys.stdout.write(f"{{low + 5}}\\n")
    sys.stdout.flush()
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("journal") / "whole.mcap"
    made_up.write_journal(path, duration_s=1.0, pictures=3)
    return path


def changed(tmp: Path, data: bytes) -> Path:
    path = tmp / "changed.mcap"
    path.write_bytes(data)
    return path


def subset_of_truth(content: journal.Journal) -> bool:
    """Every row that was read is, bit for bit, the row that was written."""
    truth = made_up.samples(1.0)[content.samples[:]["cycle"]] if len(content.samples) else content.samples[:]
    return truth.tobytes() == content.samples[:].tobytes()


def test_written_data_are_read_back_bit_for_bit(whole: Path) -> None:
    content = journal.read(whole)
    assert repr(content.header) == repr(made_up.header("whole", 1.0))
    assert content.samples[:].tobytes() == made_up.samples(1.0).tobytes()
    assert content.observations[:].tobytes() == made_up.observations(1.0).tobytes()
    assert content.events == (Event(made_up.START_NS, Level.INFO, "control", "armed"),)
    assert [bytes(p.data) for p in content.pictures[:]] == [made_up.picture(i).data for i in range(3)]
    for index, stored in enumerate(content.pictures[:]):
        for name, points in vars(made_up.marks(index)).items():
            np.testing.assert_array_equal(getattr(stored.marks, name), points)
    assert [(p.t_ns, p.frame, p.camera) for p in content.pictures[:]] == [
        (made_up.picture(i).t_ns, i * 3, "front") for i in range(3)
    ]
    assert content.footer is not None
    assert content.footer.counters == {"ring_overflows": 0, "missed_deadlines": 2}
    assert content.damage == ()


def test_the_public_mcap_reader_reads_it_and_finds_every_checksum_right(whole: Path) -> None:
    with whole.open("rb") as file:
        found = [
            (channel.topic, message.sequence, message.log_time)
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages()
        ]
    topics = [topic for topic, _, _ in found]
    assert topics.count("/samples") == 200
    assert topics.count("/observations") == 30
    assert topics.count("/pictures") == 3
    assert [number for topic, number, _ in found if topic == "/samples"] == list(range(200))
    first = next(time_ns for topic, _, time_ns in found if topic == "/samples")
    assert first == made_up.header().started_utc_ns, "viewers see wall-clock time"


def test_a_row_is_described_for_viewers_in_the_order_of_its_bytes() -> None:
    assert messages.row_definition(sample_dtype(3, 2)).splitlines() == [
        "int64 t_ns",
        "int64 cycle",
        "float64 protocol_s",
        "float64[3] setpoint_pa",
        "float64[3] measured_pa",
        "float64[2] valve_v",
        "int32 scans",
        "int32 missed",
        "int64 lateness_ns",
    ]


@pytest.mark.parametrize(("attempt", "live"), [(0, False), (1, True), (2, True)])
def test_kill_9_loses_nothing_that_was_written(tmp_path: Path, attempt: int, live: bool) -> None:
    path = tmp_path / "killed.mcap"
    script = WRITER.format(tests=str(Path(__file__).parents[3]), live=live)
    with subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        written = int(process.stdout.readline())
        time.sleep(random.Random(attempt).uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        said = process.stdout.read().split("\n")
        # The last line may be torn: only what ends in a newline was said.
        written = int(said[-2]) if len(said) > 1 else written
    content = journal.read(path)
    assert content.footer is None
    assert len(content.samples) >= written
    assert content.samples[:].tobytes() == made_up.samples(500.0)[: len(content.samples)].tobytes()
    assert len(content.pictures) >= written // 5
    assert all(bytes(p.data) == made_up.picture(p.frame // 3).data for p in content.pictures[:])


@examples(60, HealthCheck.function_scoped_fixture)
@given(part=st.floats(0, 1))
def test_a_truncated_journal_gives_everything_before_the_cut(tmp_path: Path, whole: Path, part: float) -> None:
    data = whole.read_bytes()
    path = changed(tmp_path, data[: int(part * len(data))])
    try:
        content = journal.read(path)
    except JournalError:
        assert path.stat().st_size < 10_000, "only a journal cut inside its header gives nothing"
        return
    assert content.samples[:].tobytes() == made_up.samples(1.0)[: len(content.samples)].tobytes()


@examples(150, HealthCheck.function_scoped_fixture)
@given(part=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_costs_one_block_and_is_reported(tmp_path: Path, whole: Path, part: float, bit: int) -> None:
    data = bytearray(whole.read_bytes())
    data[int(part * len(data))] ^= 1 << bit
    content = journal.read(changed(tmp_path, bytes(data)))
    assert subset_of_truth(content)
    assert len(content.samples) >= 200 - 20, "a block is 20 rows"
    assert len(content.pictures) >= 2
    lost = len(content.samples) < 200 or len(content.observations) < 30 or len(content.pictures) < 3
    assert content.damage or not lost


@examples(60, HealthCheck.function_scoped_fixture)
@given(part=st.floats(0, 1), rubbish=st.binary(min_size=1, max_size=400), replace=st.booleans())
def test_rubbish_in_the_middle_does_not_hide_the_data_behind_it(
    tmp_path: Path, whole: Path, part: float, rubbish: bytes, replace: bool
) -> None:
    data = whole.read_bytes()
    at = int(part * len(data))
    content = journal.read(changed(tmp_path, data[:at] + rubbish + data[at + (len(rubbish) if replace else 0) :]))
    assert subset_of_truth(content)
    # 400 bytes touch at most the neighbouring blocks of rows, and frames of three rows each.
    assert len(content.samples) >= 200 - 40


@examples(100, HealthCheck.function_scoped_fixture)
@given(rubbish=st.binary(max_size=3000))
def test_a_file_that_is_not_a_journal_gives_one_message(tmp_path: Path, rubbish: bytes) -> None:
    with pytest.raises(JournalError, match="is not a journal, or its header is lost"):
        journal.read(changed(tmp_path, rubbish))


def test_a_message_with_a_valid_checksum_and_invalid_content_is_reported(tmp_path: Path, whole: Path) -> None:
    from mcap.records import Message

    from runs.journal import mcap_records

    extra = mcap_records.block(mcap_records.encode(Message(messages.EVENTS, 0, b'{"t_ns": "never"}', 0, 0)), 0, 0)
    content = journal.read(changed(tmp_path, whole.read_bytes() + extra))
    assert "not understood" in str(content.damage[-1])
    assert len(content.samples) == 200


def test_a_missing_file_is_not_a_journal(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="No such file"):
        journal.read(tmp_path / "none.mcap")


def test_a_writer_never_overwrites(whole: Path) -> None:
    before = whole.read_bytes()
    with pytest.raises(JournalError, match="File exists"):
        JournalWriter(whole, made_up.header())
    assert whole.read_bytes() == before


def test_rows_of_another_kind_are_refused(tmp_path: Path) -> None:
    writer = JournalWriter(tmp_path / "a.mcap", made_up.header())
    with pytest.raises(TypeError, match="expected"):
        writer.samples(np.zeros(1, sample_dtype(1, 1)))
    writer.close(RunFooter(made_up.START_NS, Status.ABORTED, ""))


def test_the_rows_may_be_reused_after_the_call(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = JournalWriter(path, made_up.header())
    rows = made_up.samples(0.1)
    kept = rows.copy()
    writer.samples(rows)
    rows["cycle"] = -1
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    assert journal.read(path).samples[:].tobytes() == kept.tobytes()


def test_the_journal_is_locked_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = JournalWriter(path, made_up.header())
    with pytest.raises(ArchiveInUseError, match="is being written by another process"), locked(path):
        pass
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    with locked(path):
        pass


def _write_until_full(writer: JournalWriter, rows: NDArray[np.void]) -> int:
    """Return how many rows were written before the one error."""
    for low in range(0, len(rows), 7):
        try:
            writer.samples(rows[low : low + 7])
        except JournalFullError as fault:
            if "what was recorded is intact" in str(fault):
                return low
            raise
    raise AssertionError("the disk never was full")


@pytest.mark.parametrize("live", [False, True])
def test_a_full_disk_raises_one_error_and_keeps_what_was_recorded(tmp_path: Path, live: bool) -> None:
    path = tmp_path / "full.mcap"
    rows = made_up.samples(10.0)
    writer = JournalWriter(path, made_up.header(), live=live)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 100_000, hard))
        written = _write_until_full(writer, rows)
        with pytest.raises(JournalFullError):
            writer.event(Event(made_up.START_NS, Level.INFO, "test", "refused as well"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert written > 100
    writer.close(RunFooter(made_up.START_NS, Status.ABORTED, "the disk is full"))
    content = journal.read(path)
    assert content.samples[:].tobytes() == rows[:written].tobytes()
    assert content.damage == (), "the torn write was taken back"
    assert content.footer is not None


def test_a_failed_start_of_a_journal_leaves_no_file(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
        with pytest.raises(JournalFullError):
            JournalWriter(tmp_path / "a.mcap", made_up.header())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(JournalError, match="cannot create"):
        JournalWriter(tmp_path / "no folder" / "a.mcap", made_up.header())


def test_a_run_stops_while_the_disk_still_has_room_for_its_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    writer = JournalWriter(path, made_up.header())
    monkeypatch.setattr(append_only_file, "SYNC_S", 0.0)
    writer.samples(made_up.samples(0.1))
    free = os.statvfs(tmp_path)
    monkeypatch.setattr(append_only_file, "RESERVE_BYTES", free.f_bavail * free.f_frsize * 2)
    with pytest.raises(JournalFullError, match="nearly full"):
        writer.samples(made_up.samples(0.1))
    with pytest.raises(JournalFullError, match="nearly full"):
        JournalWriter(tmp_path / "b.mcap", made_up.header())
    assert not (tmp_path / "b.mcap").exists()
    writer.close(RunFooter(made_up.START_NS, Status.ABORTED, "the disk is nearly full"))
    assert len(journal.read(path).samples) == 40, "the rows of the call that was refused are kept too"


def test_the_space_reserved_for_the_archive_grows_with_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = JournalWriter(tmp_path / "a.mcap", made_up.header())
    monkeypatch.setattr(append_only_file, "SYNC_S", 0.0)
    monkeypatch.setattr(append_only_file, "RESERVE_BYTES", 0)
    free = SimpleNamespace(f_frsize=1, f_bavail=200_000)
    monkeypatch.setattr(os, "fstatvfs", lambda _: free)

    def record() -> None:
        for _ in range(1000):
            writer.samples(made_up.samples(0.1))

    with pytest.raises(JournalFullError, match="nearly full"):
        record()
    # An archive is about as large as its journal.
    assert 100_000 < (tmp_path / "a.mcap").stat().st_size < 200_000
    writer.close(RunFooter(made_up.START_NS, Status.ABORTED, "the disk is nearly full"))


@pytest.mark.parametrize("live", [False, True])
def test_a_disk_that_turns_read_only_is_reported_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, live: bool
) -> None:
    def refused(*_: object) -> int:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    writer = JournalWriter(tmp_path / "run.mcap", made_up.header(), live=live)
    writer.samples(made_up.samples(0.5))
    with monkeypatch.context() as readonly:
        readonly.setattr(os, "write", refused)
        readonly.setattr(os, "ftruncate", refused)
        with pytest.raises(JournalError, match=r"cannot write .*Read-only file system"):
            writer.samples(made_up.samples(0.5))
    writer.close(RunFooter(0, Status.ABORTED, ""))
    assert len(journal.read(tmp_path / "run.mcap").samples) == len(made_up.samples(0.5))


def test_data_older_than_a_second_are_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    path = tmp_path / "a.mcap"
    monkeypatch.setattr(os, "fdatasync", lambda fd: synced.append(os.fstat(fd).st_size))
    clock = iter(np.arange(0.0, 1000.0, 0.3).tolist())
    monkeypatch.setattr(append_only_file.time, "monotonic", lambda: next(clock))
    writer = JournalWriter(path, made_up.header())
    for _ in range(10):
        writer.samples(made_up.samples(0.1))
    assert len(synced) >= 2
    assert synced[0] > 0
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    assert synced[-1] == path.stat().st_size


@given(
    st.builds(
        RunFooter,
        t_ns=st.integers(-(2**63), 2**63 - 1),
        status=st.sampled_from(Status),
        message=st.text(),
        counters=st.dictionaries(st.text(), st.integers(-(2**63), 2**63 - 1)),
    )
)
def test_a_footer_survives_its_encoding(footer: RunFooter) -> None:
    assert messages.from_json(RunFooter, messages.to_json(footer)) == footer


@given(text=st.text(), value=st.tuples(st.floats(allow_subnormal=True)), uncertainty=st.floats())
def test_a_header_survives_its_encoding(text: str, value: tuple[float, ...], uncertainty: float) -> None:
    plain = made_up.header()
    quantities = (dataclasses.replace(plain.quantities[0], name=text, value=value, uncertainty=uncertainty),)
    header = dataclasses.replace(plain, notes=text, protocol_yaml=text, quantities=quantities, seed=None)
    again = messages.from_json(RunHeader, messages.to_json(header))
    assert repr(again) == repr(header)


def test_the_journal_of_another_version_is_read_by_the_names_of_its_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    older = np.dtype([("t_ns", "<i8"), ("measured_pa", "<f8", (3,)), ("gone", "<i4")])
    monkeypatch.setattr(row_kinds, "sample_dtype", lambda *_: older)
    writer = JournalWriter(tmp_path / "old.mcap", made_up.header())
    rows = np.zeros(2, older)
    rows["t_ns"], rows["measured_pa"] = (5, 6), 7.0
    writer.samples(rows)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    monkeypatch.undo()
    samples = journal.read(tmp_path / "old.mcap").samples[:]
    assert samples.dtype == sample_dtype(3, 2)
    assert (list(samples["t_ns"]), samples["measured_pa"][1, 2], samples["cycle"][0]) == ([5, 6], 7.0, 0)
    assert np.isnan(samples["setpoint_pa"]).all()
