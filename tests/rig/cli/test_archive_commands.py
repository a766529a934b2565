"""What the commands about archives print where there is little to print, or nowhere to write it."""

from __future__ import annotations

import dataclasses
import importlib
import io
import resource
import subprocess
import sys
from pathlib import Path

import pytest

import tests.support.synthetic_runs as made_up
from rig.cli.expected_errors import EXPECTED_ERRORS
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, Status
from runs.report import page
from tests.support.command_line import status_of


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """A run so short that no frame was seen and no pressure settled."""
    made_up.write_journal(tmp_path / "short.mcap", duration_s=0.0, pictures=0)
    return finalise(tmp_path / "short.mcap")


def test_a_missing_measurement_is_shown_as_a_dash(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("show", short) == 0
    shown = capsys.readouterr().out
    assert "nan" not in shown
    assert [line.split()[-1] for line in shown.splitlines() if "mean error" in line] == ["-"]


def test_a_run_without_deadlines_is_not_reported_to_have_met_them(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made_up.write_journal(tmp_path / "timed.mcap", duration_s=0.1)
    assert status_of("show", short) == 0
    assert "deadlines" not in capsys.readouterr().out
    assert status_of("show", finalise(tmp_path / "timed.mcap")) == 0
    assert "deadlines missed" in capsys.readouterr().out


def test_a_listed_run_can_be_named_as_it_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_id = "20260102-030405-extension-weights-replay-12"
    named = dataclasses.replace(
        made_up.header(run_id), rig_name="a-bench-of-many-words", protocol_name="weights-up-and-down", operator="grace"
    )
    writer = JournalWriter(tmp_path / f"{run_id}.mcap", named)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    finalise(writer.path)
    assert status_of("runs", tmp_path) == 0
    assert run_id in capsys.readouterr().out


def test_a_terminal_that_cannot_show_a_sign_gets_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = JournalWriter(tmp_path / "u.mcap", dataclasses.replace(made_up.header("u"), title="Größe 腕"))
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    archive, plain = finalise(writer.path), io.TextIOWrapper(io.BytesIO(), "latin-1")
    monkeypatch.setattr(sys, "stdout", plain)
    assert status_of("show", archive) == 0
    plain.seek(0)
    assert "Größe ?" in plain.read()


def test_a_report_goes_into_a_new_folder(short: Path, tmp_path: Path) -> None:
    assert status_of("report", short, "--to", tmp_path / "new" / "folder" / "a.html") == 0
    assert (tmp_path / "new" / "folder" / "a.html").read_text(encoding="utf-8").startswith("<!doctype html>")


def test_an_error_of_the_system_is_shown_without_its_number(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("report", short, "--to", "/proc/nowhere/a.html") == 1
    assert capsys.readouterr().err == "/proc/nowhere: No such file or directory\n"


@pytest.mark.parametrize("name", EXPECTED_ERRORS)
def test_every_expected_error_is_a_class_of_this_name(name: str) -> None:
    module, _, kind = name.rpartition(".")
    found = getattr(importlib.import_module(module), kind)
    assert issubclass(found, Exception)
    assert f"{found.__module__}.{found.__qualname__}" == name


def test_a_refusal_needs_no_more_memory_than_the_command(tmp_path: Path) -> None:
    (tmp_path / "damaged.h5").write_bytes(b"no archive")
    limit = 600_000 * 1024
    done = subprocess.run(
        [sys.executable, "-m", "rig", "show", str(tmp_path / "damaged.h5")],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.splitlines() == [f"{tmp_path}/damaged.h5: not an archive of softrig: it is no HDF5 file"]


def test_a_library_that_finds_no_memory_gives_one_sentence(
    short: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ImportError("libopenblas.so: failed to map segment from shared object")

    monkeypatch.setattr(page, "write", fail)
    assert status_of("report", short) == 1
    assert capsys.readouterr().err.startswith("not enough memory: libopenblas.so")


def test_last_names_the_reason_where_no_archive_is_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "20260102-030405-x.h5").write_bytes(b"no archive")
    assert status_of("show", "last") == 2
    assert "no HDF5 file" in capsys.readouterr().err


def test_a_folder_is_no_part_of_a_run_id(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("show", "/") == 2
    assert "a folder, not an archive" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [("--since", "2026-13"), ("--until", "2026-02-32"), ("--since", "2026-02-03T25")],
)
def test_a_filter_that_no_archive_can_match_is_refused(tmp_path: Path, words: tuple[str, str]) -> None:
    assert status_of("runs", tmp_path, *words) == 2
    assert status_of("runs", tmp_path, "--since", "2026-12-31T23:59") == 0
