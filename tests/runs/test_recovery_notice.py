"""Commands that read a folder report runs that were cut off, but not running ones."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import tests.support.synthetic_runs as made_up
from rig.cli.run_names import report_interrupted
from runs.records import RunFooter, Status
from tests.runs.test_recovery import orphan
from tests.support.command_line import status_of

PATIENCE_S = 120


def rig(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rig", *arguments]
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=PATIENCE_S, check=True)


def test_every_command_that_reads_the_folder_reports_a_run_that_was_cut_off_on_the_error_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    orphan(folder / "cut.mcap")
    listed = rig("runs", "--json", cwd=tmp_path)
    assert listed.stderr.splitlines() == [
        "a run was cut off (cut.mcap): `rig recover data` makes archives of what was recorded"
    ]
    assert listed.stdout == "[]\n"
    monkeypatch.chdir(tmp_path)
    for command in (["recover"], ["show", "cut"]):
        capfd.readouterr()
        assert status_of(*command) == 0
    assert capfd.readouterr().err == ""


def test_a_running_experiment_is_not_an_orphan(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    writer = made_up.write_journal(tmp_path / "going.mcap", footer=False)
    report_interrupted(tmp_path)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    assert capfd.readouterr().err == ""
