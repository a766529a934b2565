"""Finalising a journal: checked content, a synced file, full disks, cut-off runs, little memory."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

import runs
import tests.support.synthetic_runs as made_up
from runs.archive import digest
from runs.archive import fields as groups
from runs.archive import writer as archive
from runs.archive.writer import ArchiveError, ArchiveInUseError, finalise
from runs.journal import journal
from runs.records import RunFooter, Status
from scripts.faults import environment
from scripts.faults.environment import UnsupportedFaultError

FULL = """
import resource, signal, sys
from runs.archive.writer import ArchiveError, finalise
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    finalise(sys.argv[1])
except ArchiveError as fault:
    sys.stdout.write(str(fault))
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = tmp_path_factory.mktemp("archive") / "run.mcap"
    made_up.write_journal(source, pictures=5)
    return finalise(source)


def test_a_run_cut_off_before_its_first_sample_still_gives_an_archive(tmp_path: Path) -> None:
    source = tmp_path / "empty.mcap"
    made_up.write_journal(source, duration_s=0.0, footer=False, pictures=0)
    source = source.rename(tmp_path / "moved.mcap")
    shutil.copy(source, tmp_path / "copy.mcap")
    run = runs.open(finalise(tmp_path / "copy.mcap"))
    assert run.status is Status.RECOVERED
    assert len(run.pressure.time_s) == len(run.tip.time_s) == len(run.frames.time_s) == 0
    assert "recovered" in run.events[-1].message


def test_the_journal_of_a_living_writer_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "live.mcap"
    writer = made_up.write_journal(source, footer=False)
    with pytest.raises(ArchiveInUseError):
        finalise(source)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    assert finalise(source).exists()


def test_finalising_again_gives_the_same_file(path: Path) -> None:
    before = path.read_bytes()
    finalise(path.with_suffix(".mcap"))
    assert path.read_bytes() == before


def test_content_that_reads_back_differently_is_not_renamed_to_an_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "run.mcap"
    made_up.write_journal(source)
    sync = archive._sync

    def onto_a_bad_disk(path: Path) -> None:
        if path.name.endswith(archive.PART):
            with path.open("r+b") as file:
                file.seek(5000)
                file.write(b"\xff" * 8)
        sync(path)

    monkeypatch.setattr(archive, "_sync", onto_a_bad_disk)
    with pytest.raises(ArchiveError, match="read back"):
        finalise(source)
    assert not source.with_suffix(".h5").exists()


def test_an_archive_is_synced_to_disk_before_its_rename_and_the_rename_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    named = Path.replace

    def replace(part: Path, target: Path) -> Path:
        done.append(f"{part.name} becomes {target.name}")
        return named(part, target)

    monkeypatch.setattr(os, "fsync", lambda handle: done.append(Path(f"/proc/self/fd/{handle}").readlink().name))
    monkeypatch.setattr(Path, "replace", replace)
    made_up.write_journal(tmp_path / "run.mcap", duration_s=0.1)
    finalise(tmp_path / "run.mcap")
    assert done == ["run.h5.part", "run.h5.part becomes run.h5", tmp_path.name]


def test_a_disk_that_fills_while_the_archive_is_made_does_not_touch_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_room = archive._take_room

    def just_in_time(part: Path, size: int) -> None:
        take_room(part, size)
        environment.fill(part.parent)

    monkeypatch.setattr(archive, "_take_room", just_in_time)
    try:
        with environment.small_disk(tmp_path / "disk"):
            source = tmp_path / "disk" / "run.mcap"
            made_up.write_journal(source)
            made = finalise(source)
            assert digest.checked(made)
            assert made.stat().st_blocks * 512 < made.stat().st_size + 4096
    except UnsupportedFaultError as why:
        pytest.skip(str(why))


@pytest.mark.parametrize("room", [0, 3000, 300_000])
def test_a_full_disk_leaves_the_journal_and_no_half_archive(tmp_path: Path, room: int) -> None:
    source = tmp_path / "run.mcap"
    made_up.write_journal(source)
    # In a process of its own: HDF5 that meets a full disk can take its process down, which must not happen either.
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(source), str(room)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "the disk is full; the journal holds everything" in done.stdout
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]
    assert len(journal.read(source).samples) == 600


def test_an_archive_that_cannot_be_written_is_named_without_its_temporary_file(tmp_path: Path) -> None:
    source = tmp_path / "run.mcap"
    made_up.write_journal(source)
    target = Path("/sys/kernel/run.h5")  # not even root can make a file there
    with pytest.raises(ArchiveError, match=f"^cannot write {target}: Permission denied; the journal holds everything$"):
        archive.write(journal.read(source), target, 10_000)


@pytest.mark.slow
def test_a_long_run_is_finalised_in_the_memory_of_a_short_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (groups, archive):
        monkeypatch.setattr(module, "CHUNK_ROWS", 1024)
    source = tmp_path / "long.mcap"
    made_up.write_journal(source, duration_s=100.0)
    tracemalloc.start()
    try:
        made = finalise(source)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 0.5 * source.stat().st_size, "the rows were held, or what was made of them"
    assert len(runs.open(made).pressure.cycle) == 20_000
