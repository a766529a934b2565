"""The process that draws a run's report: ready before the archive is, and no way for a failure to go unsaid."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import tests.support.synthetic_runs as made_up
from rig.experiment import report_process
from runs.archive.writer import finalise
from runs.report.page import write


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """A run so short that few figures are drawn of it."""
    path = tmp_path / "run.mcap"
    made_up.write_journal(path, duration_s=0.03, pictures=1)
    return finalise(path)


@pytest.mark.slow
def test_the_report_is_the_one_that_rig_report_draws(archive: Path, tmp_path: Path) -> None:
    with report_process.started() as begin:
        drawn = begin(archive)()
    assert drawn == archive.with_suffix(".html")
    assert drawn.read_bytes() == write([archive], tmp_path / "other.html").read_bytes()


@pytest.mark.slow
def test_a_report_that_cannot_be_written_is_raised_here(archive: Path) -> None:
    archive.with_suffix(".html").mkdir()
    with report_process.started() as begin, pytest.raises(OSError, match=r"run\.html"):
        begin(archive)()


def test_where_the_process_cannot_draw_the_report_is_drawn_here(archive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with report_process.started() as begin:
        drawn = begin(archive)()
    assert drawn.stat().st_size > 0


def test_a_run_that_leaves_no_archive_leaves_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    class Watched(subprocess.Popen[bytes]):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Watched)
    with pytest.raises(RuntimeError), report_process.started():
        raise RuntimeError
    (process,) = started
    assert process.returncode is not None
