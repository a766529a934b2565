"""The `rig` command: what it prints, what it returns, and that no error of the user's is a traceback."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from beside import shared_data

import runs
from runs.records import Seen

SHORT = "title: Short\nsteps:\n  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}\n"


def rig(arguments: Sequence[str | Path], cwd: Path, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """Run the command as a user would."""
    return subprocess.run(
        [sys.executable, "-m", "rig", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        input=stdin,
        check=False,
        timeout=120,
    )


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one short virtual run in data/."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "short.yaml").write_text(SHORT)
    done = rig(["run", "short.yaml", "--fast", "--yes", "--operator", "ada", "--note", "first"], folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_a_run_leaves_an_archive_and_a_report_in_the_data_folder(recorded: Path) -> None:
    (archive,) = (recorded / "data").glob("*.h5")
    assert archive.with_suffix(".html").stat().st_size > 10_000
    run = runs.open(archive)
    assert run.header.operator == "ada"
    assert run.header.notes == "first"
    assert run.header.protocol_yaml == SHORT


def test_the_last_screen_says_how_it_ended_and_where_it_lies(recorded: Path) -> None:
    done = rig(["run", "short.yaml", "--fast", "--yes", "--out", "elsewhere"], recorded)
    assert "finished" in done.stdout
    assert "elsewhere/" in done.stdout
    assert "mean error" in done.stdout


def test_help_does_not_import_the_heavy_rooms(tmp_path: Path) -> None:
    program = (
        "import sys, rig.cli\n"
        "try: rig.cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'cv2', 'h5py', 'scipy', 'matplotlib', 'pydantic'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "ramp-z", "--fast", "--yes"], "ramp-a"),
        (["run", "ramp-a", "--rig", "mook", "--fast", "--yes"], "mock"),
        (["run", "ramp-a", "--model", "homogenous", "--fast", "--yes"], "homogeneous"),
        (["run", "missing.yaml", "--fast", "--yes"], "missing.yaml"),
        (["check", "/"], "/"),
        (["show", "no-such-run"], "no-such-run"),
        (["report", "no-such-run"], "no-such-run"),
        (["export", "no-such-run"], "no-such-run"),
        (["calibrate", "camera", "nowhere", "--corners", "9x6", "--square-mm", "25"], "nowhere"),
        (["calibrate", "camera", ".", "--corners", "9", "--square-mm", "25"], "9x6"),
        (["run", "ramp-a", "--seed", "-1", "--fast", "--yes"], "seed"),
    ],
)
def test_bad_input_gives_one_message_and_status_2(tmp_path: Path, arguments: list[str], said: str) -> None:
    done = rig(arguments, tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_what_is_wrong_with_the_protocol_and_the_rig_is_said_at_once(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("title: x\nsteps: 3\n")
    (tmp_path / "r.yaml").write_text("name: 3\n")
    done = rig(["check", "p.yaml", "--rig", "r.yaml"], tmp_path)
    assert done.returncode == 2
    assert "p.yaml:2" in done.stderr
    assert "r.yaml:1" in done.stderr


def test_without_yes_and_without_a_terminal_nothing_is_armed(tmp_path: Path) -> None:
    done = rig(["run", "ramp-a", "--fast"], tmp_path, stdin="y\n")
    assert done.returncode == 2
    assert "--yes" in done.stdout
    assert not (tmp_path / "data").exists()


def test_a_data_folder_that_cannot_be_written_is_said_so(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    done = rig(["run", "ramp-a", "--fast", "--yes"], tmp_path)
    assert done.returncode in (1, 2)
    assert "data" in done.stderr
    assert "Traceback" not in done.stderr


def test_check_prints_the_peak_pressure_and_the_limit_without_touching_anything(tmp_path: Path) -> None:
    facts = json.loads(rig(["check", "ramp-b", "--json"], tmp_path).stdout)
    assert facts["peak_bar"] == pytest.approx([0, 0.65, 0.65])
    assert facts["limit_bar"] >= 0.65
    assert not list(tmp_path.iterdir())


def test_doctor_names_what_is_missing_and_what_to_do(tmp_path: Path) -> None:
    findings = json.loads(rig(["doctor", "--json"], tmp_path).stdout)
    assert {"Python", "board", "pycomedi", "camera", "real-time priority", "disk"} <= {f["topic"] for f in findings}
    assert all(f["remedy"] for f in findings if f["verdict"] != "ok")


def test_show_prints_how_a_run_was_made(recorded: Path) -> None:
    (archive,) = (recorded / "data").glob("*.h5")
    shown = rig(["show", archive.stem], recorded).stdout
    for fact in (archive.stem, "simulated", "ada", "short", "virtual time", "mean error"):
        assert fact in shown
    facts = json.loads(rig(["show", archive, "--json"], recorded).stdout)
    assert facts["header"]["operator"] == "ada"


def test_runs_lists_archives_and_filters_them(recorded: Path) -> None:
    assert len(json.loads(rig(["runs", "--json"], recorded).stdout)) == 1
    assert json.loads(rig(["runs", "--json", "--text", "nobody"], recorded).stdout) == []


def test_export_writes_tables_with_the_unit_in_every_header(recorded: Path) -> None:
    (archive,) = (recorded / "data").glob("*.h5")
    done = rig(["export", archive.stem, "--to", "csv", "--out", "tables"], recorded)
    assert done.returncode == 0, done.stderr
    (pressure,) = (recorded / "tables").glob("*-pressure.csv")
    head = pressure.read_text().splitlines()[0].split(",")
    assert "time_s" in head
    assert any(name.startswith("measured") and name.endswith("bar") for name in head)


def test_calibrate_camera_gives_the_published_focal_length_of_real_views(tmp_path: Path) -> None:
    views = shared_data("chessboard")
    done = rig(["calibrate", "camera", views, "--corners", "9x6", "--square-mm", "25", "--json"], tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["fx_px"] == pytest.approx(535.92, rel=0.01)
    assert facts["rms_px"] < 0.3


def test_recover_makes_an_archive_of_an_orphaned_journal(recorded: Path, tmp_path: Path) -> None:
    (journal,) = (recorded / "data").glob("*.mcap")
    data = journal.read_bytes()
    (tmp_path / "orphan.mcap").write_bytes(data[: len(data) // 2])
    done = rig(["recover", tmp_path], recorded)
    assert done.returncode == 0, done.stdout
    assert "recovered" in done.stdout
    assert len(runs.open(tmp_path / "orphan.h5").pressure.time_s) > 10
    assert "nothing to recover" in rig(["recover", tmp_path], recorded).stdout


def test_simulate_leaves_the_models_tip_alone_in_the_same_layout(tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(SHORT)
    done = rig(["simulate", "short.yaml", "--model", "homogeneous", "--static", "--out", "out"], tmp_path)
    assert done.returncode == 0, done.stderr
    run = runs.open(tmp_path / done.stdout.strip())
    assert np.all(run.tip.seen == Seen.NO_FRAME)
    assert np.all(np.isnan(run.tip.measured_mm))
    assert run.tip.model_mm[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert run.tip.model_mm[-1, 0] < -10.0
