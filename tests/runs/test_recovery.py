"""Recovery: archives from what a crash left; nothing unreadable is ever deleted."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest

import runs
import tests.support.synthetic_runs as made_up
from runs.archive.writer import locked
from runs.records import RunFooter, Status
from runs.recovery import RecoveryStatus, orphans, recover

ORPHAN = """
import os, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from tests.support import synthetic_runs as made_up
made_up.write_journal(Path(sys.argv[1]), footer=False)
os.kill(os.getpid(), 9)
"""


FINALISE = """
import os, sys
from runs.archive import writer
writer.digest.seal = lambda file: os.kill(os.getpid(), 9)
writer.finalise(sys.argv[1])
"""


def orphan(path: Path) -> Path:
    """A journal whose writer was killed."""
    script = ORPHAN.format(tests=str(Path(__file__).parents[2]))
    assert subprocess.run([sys.executable, "-c", script, str(path)], check=False).returncode == -9
    return path


def fates(folder: Path) -> dict[str, RecoveryStatus]:
    return {outcome.path.name: outcome.status for outcome in recover(folder)}


def test_an_orphan_becomes_an_archive_with_status_recovered(tmp_path: Path) -> None:
    path = orphan(tmp_path / "run.mcap")
    assert orphans(tmp_path) == (path,)
    (outcome,) = recover(tmp_path)
    assert (outcome.status, outcome.archive) == (RecoveryStatus.RECOVERED, tmp_path / "run.h5")
    assert outcome.message == "600 samples, 90 frames, 5 pictures"
    run = runs.open(tmp_path / "run.h5")
    assert run.status is Status.RECOVERED
    assert run.duration_s == pytest.approx(3.0, abs=0.01)
    assert (run.events[-1].source, run.events[-1].level) == ("recovery", "warning")
    assert path.exists()


def test_recovering_again_changes_nothing(tmp_path: Path) -> None:
    orphan(tmp_path / "run.mcap")
    recover(tmp_path)
    before = {p.name: p.stat().st_mtime_ns for p in tmp_path.iterdir()}
    assert fates(tmp_path) == {"run.mcap": RecoveryStatus.ARCHIVED}
    assert {p.name: p.stat().st_mtime_ns for p in tmp_path.iterdir()} == before
    assert orphans(tmp_path) == ()


def test_a_run_that_had_ended_keeps_its_status(tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "run.mcap")
    assert fates(tmp_path) == {"run.mcap": RecoveryStatus.FINALISED}
    assert runs.open(tmp_path / "run.h5").status is Status.FINISHED


def test_a_run_in_progress_is_left_alone(tmp_path: Path) -> None:
    writer = made_up.write_journal(tmp_path / "run.mcap", footer=False)
    assert orphans(tmp_path) == ()
    assert fates(tmp_path) == {"run.mcap": RecoveryStatus.RUNNING}
    assert not (tmp_path / "run.h5").exists()
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))


def test_a_journal_that_cannot_be_read_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "rubbish.mcap").write_bytes(os.urandom(5000))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert fates(tmp_path) == {"empty.mcap": RecoveryStatus.UNREADABLE, "rubbish.mcap": RecoveryStatus.UNREADABLE}
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_one_unreadable_journal_does_not_stop_the_others(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"rubbish")
    made_up.write_journal(tmp_path / "b.mcap")
    assert fates(tmp_path) == {"a.mcap": RecoveryStatus.UNREADABLE, "b.mcap": RecoveryStatus.FINALISED}


def test_the_readable_part_of_a_damaged_journal_is_recovered_and_the_loss_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    made_up.write_journal(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 0xFF
    path.write_bytes(data[: len(data) // 2])
    (outcome,) = recover(tmp_path)
    assert outcome.status is RecoveryStatus.RECOVERED
    assert "not readable" in outcome.message
    assert "bytes at" in runs.open(tmp_path / "run.h5").events[-1].message


def test_an_archive_that_cannot_be_opened_is_set_aside_and_made_again(tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "run.mcap")
    recover(tmp_path)
    whole = (tmp_path / "run.h5").read_bytes()
    torn = whole[: len(whole) // 2]
    (tmp_path / "run.h5").write_bytes(torn)
    (outcome,) = recover(tmp_path)
    assert "kept as run.h5.unreadable-1" in outcome.message
    assert (tmp_path / "run.h5.unreadable-1").read_bytes() == torn
    assert runs.open(tmp_path / "run.h5").status is Status.FINISHED


def test_files_of_an_interrupted_finalisation_are_removed(tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "run.mcap")
    (tmp_path / "run.h5.part").write_bytes(b"half an archive")
    assert fates(tmp_path) == {"run.h5.part": RecoveryStatus.REMOVED, "run.mcap": RecoveryStatus.FINALISED}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.h5", "run.mcap"]


def test_a_finalisation_that_was_killed_is_repeated(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    made_up.write_journal(path)
    assert subprocess.run([sys.executable, "-c", FINALISE, str(path)], check=False).returncode == -9
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.h5.part", "run.mcap"]
    assert fates(tmp_path) == {"run.h5.part": RecoveryStatus.REMOVED, "run.mcap": RecoveryStatus.FINALISED}
    assert runs.open(tmp_path / "run.h5").status is Status.FINISHED


def test_an_archive_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    made_up.write_journal(path)
    (tmp_path / "run.h5.part").write_bytes(b"half")
    with locked(path):
        assert fates(tmp_path) == {"run.mcap": RecoveryStatus.RUNNING}
    assert (tmp_path / "run.h5.part").exists()


def test_an_empty_or_missing_folder_has_nothing_to_recover(tmp_path: Path) -> None:
    assert recover(tmp_path) == ()
    assert recover(tmp_path / "none") == ()


def test_reading_holds_no_file_open(tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "run.mcap")
    recover(tmp_path)
    runs.open(tmp_path / "run.h5").tip  # noqa: B018
    gc.collect()
    opened = [str(p.readlink()) for p in Path("/proc/self/fd").iterdir() if p.is_symlink()]
    assert not [name for name in opened if str(tmp_path) in name]
