"""The `rig` command: output, exit status, and messages instead of tracebacks."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config import loader
from rig.hardware import runtime_folder
from rig.simulator.registers import Registers
from runs.records import DetectionStatus
from scripts.rig_process import write_rig
from tests.support.command_line import status_of

SHORT = "title: Short\nsteps:\n  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}\n"


def rig(arguments: Sequence[str | Path], cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the command as a user would."""
    return subprocess.run(
        [sys.executable, "-m", "rig", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        check=False,
        timeout=120,
    )


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one short virtual run in data/."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "short.yaml").write_text(SHORT)
    done = rig(["run", "short.yaml", "--fast", "--yes", "--operator", "ada", "--note", "first"], folder)
    assert done.returncode == 0, done.stderr
    (folder / "said.txt").write_text(done.stdout)
    return folder


def test_a_run_leaves_an_archive_and_a_report_in_the_data_folder(recorded: Path) -> None:
    (archive,) = (recorded / "data").glob("*.h5")
    assert archive.with_suffix(".html").stat().st_size > 10_000
    run = runs.open(archive)
    assert run.header.operator == "ada"
    assert run.header.notes == "first"
    assert run.header.protocol_yaml == SHORT


def test_the_last_screen_states_the_outcome_and_the_files(recorded: Path) -> None:
    said = (recorded / "said.txt").read_text()
    assert "finished" in said
    assert "archive  data/" in said
    assert "whole run (simulated): mean error" in said


def test_help_does_not_import_the_heavy_rooms(tmp_path: Path) -> None:
    program = (
        "import sys, rig.cli.app\n"
        "try: rig.cli.app.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'cv2', 'h5py', 'scipy', 'matplotlib', 'pydantic'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_check_imports_nothing_that_only_a_run_needs(tmp_path: Path) -> None:
    program = (
        "import sys, rig.cli.app\n"
        "try: rig.cli.app.main(['check', 'ramp-a'])\n"
        "except SystemExit: pass\n"
        "heavy = {'numba', 'cv2', 'h5py', 'mcap', 'scipy', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def ended_by_ctrl_c(code: str) -> tuple[int, str, str]:
    """Exit status, output and errors of a program that sends SIGINT to itself."""
    # A shell ignores SIGINT for what it starts in the background.
    program = f"import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n{code}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def test_ctrl_c_before_the_command_line_is_read_ends_the_program_silently() -> None:
    code = (
        "import typer.main\n"
        "typer.main.get_command = lambda app: signal.raise_signal(signal.SIGINT)\n"
        "from rig.__main__ import main; main()"
    )
    assert ended_by_ctrl_c(code) == (130, "", "")


def test_ctrl_c_while_modules_load_ends_the_program_silently() -> None:
    interrupted_in_an_import = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'typer': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from rig.__main__ import main\n"
        "main()\n"
    )
    command = [sys.executable, "-c", interrupted_in_an_import]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGINT, "", "")


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
        (["run", "ramp-a", "--fast", "--yes", "--host", "0.0.0.0"], "--live"),
        (["show", "."], "a folder, not an archive"),
        (["show", "/"], "a folder, not an archive"),
        (["show", "x" * 300], "File name too long"),
        (["report", "no-such-run", "--to", "other.h5"], "ends with .html"),
        (["report", "no-such-run", "--to", "."], "ends with .html"),
        (["runs", "nowhere"], "a folder of archives"),
        (["recover", "nowhere"], "a folder of archives"),
        (["runs", "--since", "yesterday"], "a date or its beginning"),
        (["run", "ramp-a", "--rig", "pci1716", "--fast", "--yes"], "omit --fast"),
        (["calibrate", "pressure", "--rig", "pci1716", "--fast", "--yes"], "omit --fast"),
        (["live", "--pid", "1"], "process 1 runs no experiment of yours"),
    ],
)
def test_bad_input_gives_one_message_and_status_2(
    here: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of(*arguments) == 2
    assert said in capsys.readouterr().err
    assert not list(here.iterdir())


def test_bad_input_in_a_separate_process_gives_the_same_message_without_a_traceback(tmp_path: Path) -> None:
    done = rig(["run", "ramp-z", "--fast", "--yes"], tmp_path)
    assert done.returncode == 2, done.stderr
    assert "ramp-a" in done.stderr
    assert "Traceback" not in done.stderr


def test_an_address_of_another_machine_is_bad_input(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for address in ("lab", "192.0.2.1"):
        assert status_of("run", "ramp-a", "--yes", "--no-report", "--live", "--host", address) == 2
        assert f"found     {address}" in capsys.readouterr().err


def test_faults_of_protocol_and_rig_are_reported_at_once(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "p.yaml").write_text("title: x\nsteps: 3\n")
    (here / "r.yaml").write_text("name: 3\n")
    assert status_of("check", "p.yaml", "--rig", "r.yaml") == 2
    said = capsys.readouterr().err
    assert "p.yaml:2" in said
    assert "r.yaml:1" in said


def test_without_yes_and_without_a_terminal_nothing_is_armed(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert status_of("run", "ramp-a", "--fast") == 2
    assert "--yes" in capsys.readouterr().out
    assert not (here / "data").exists()


def test_vent_names_the_bench_and_states_that_it_is_simulated(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (here / "shared").mkdir(mode=0o700)
    monkeypatch.setattr(runtime_folder, "BASE", here / "shared")  # this vents no run of other tests
    bench = write_rig(here)
    registers = Registers.create(loader.load(bench).cards["daq"].device, outputs=2, inputs=16)
    try:
        assert status_of("vent", "--rig", bench) == 0
    finally:
        registers.path.unlink()
    assert "every chamber of rig mock is open to the exhaust (simulated" in capsys.readouterr().out


def test_a_data_folder_that_cannot_be_written_is_reported(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "data").write_text("a file")
    assert status_of("run", "ramp-a", "--fast", "--yes") in (1, 2)
    assert "data" in capsys.readouterr().err


def test_check_prints_the_peak_pressure_and_the_limit_without_touching_anything(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of("check", "ramp-b", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["peak_bar"] == pytest.approx([0, 0.65, 0.65])
    assert facts["limit_bar"] >= 0.65
    assert not list(here.iterdir())


@pytest.mark.parametrize(
    ("simulated", "real", "named"),
    [
        ("daq: {driver: mock, device: mock0", "daq: {driver: comedi, device: pci1716", "card daq"),
        ("    driver: mock\n    device: mock0", "    driver: opencv\n    device: /dev/video0", "camera front"),
    ],
)
def test_a_real_device_beside_a_simulated_one_is_not_called_untouched(
    simulated: str, real: str, named: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "mixed.yaml").write_text(loader.text("mock").replace(simulated, real))
    assert status_of("check", "ramp-a", "--rig", "mixed.yaml") == 0
    assert f"SIMULATED in part: {named} is real" in capsys.readouterr().out


@pytest.mark.usefixtures("here")
def test_doctor_names_what_is_missing_and_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    status_of("doctor", "--json")
    findings = json.loads(capsys.readouterr().out)
    assert {"Python", "board", "pycomedi", "camera", "real-time priority", "disk"} <= {f["topic"] for f in findings}
    assert all(f["remedy"] for f in findings if f["verdict"] != "ok")


def test_show_prints_how_a_run_was_made(
    recorded: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(recorded)
    (archive,) = (recorded / "data").glob("*.h5")
    assert status_of("show", archive.stem) == 0
    shown = capsys.readouterr().out
    seen_by = "camera front: checkerboard of 30 corners"
    for fact in (archive.stem, "simulated", "ada", "short", "virtual time", "mean error", seen_by):
        assert fact in shown
    status_of("show", archive, "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts["header"]["operator"] == "ada"


def test_runs_lists_archives_and_filters_them(
    recorded: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(recorded)
    for options, found in (((), 1), (("--text", "absent"), 0)):
        assert status_of("runs", "--json", *options) == 0
        assert len(json.loads(capsys.readouterr().out)) == found


def test_export_writes_tables_with_the_unit_in_every_header(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(recorded)
    (archive,) = (recorded / "data").glob("*.h5")
    assert status_of("export", archive.stem, "--format", "csv", "--out", "tables") == 0
    (pressure,) = (recorded / "tables").glob("*-pressure.csv")
    head = pressure.read_text().splitlines()[0].split(",")
    assert "time_s" in head
    assert any(name.startswith("measured") and name.endswith("bar") for name in head)


def test_recover_makes_an_archive_of_an_orphaned_journal(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (journal,) = (recorded / "data").glob("*.mcap")
    data = journal.read_bytes()
    (tmp_path / "orphan.mcap").write_bytes(data[: len(data) // 2])
    assert status_of("recover", tmp_path) == 0
    assert "recovered" in capsys.readouterr().out
    assert len(runs.open(tmp_path / "orphan.h5").pressure.time_s) > 10
    assert status_of("recover", tmp_path) == 0
    assert "nothing to recover" in capsys.readouterr().out


def test_simulate_writes_only_the_models_tip_in_the_same_layout(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "short.yaml").write_text(SHORT)
    assert status_of("simulate", "short.yaml", "--model", "homogeneous", "--out", "out") == 0
    archive = here / capsys.readouterr().out.strip()
    assert status_of("replay", archive) == 2
    assert "holds no pictures" in capsys.readouterr().err
    run = runs.open(archive)
    assert np.all(run.tip.seen == DetectionStatus.NO_FRAME)
    assert np.all(np.isnan(run.tip.measured_mm))
    assert run.tip.model_mm[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert run.tip.model_mm[-1, 0] < -10.0


def test_a_run_in_which_no_frame_showed_the_tip_says_so(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "short.yaml").write_text(SHORT)
    (here / "dark.yaml").write_text(loader.text("mock").replace("noise_grey: 2.0", "noise_grey: 2.0, lighting: 0.05"))
    assert status_of("run", "short.yaml", "--rig", "dark.yaml", "--fast", "--yes", "--no-report") == 0
    assert "no tip was measured in" in capsys.readouterr().out


@pytest.mark.parametrize("gone", ["openpty", "pipe"])
def test_a_closed_terminal_does_not_change_how_a_run_ends(gone: str) -> None:
    program = (
        "import os, sys\n"
        f"outer, inner = os.{gone}()\n"
        "os.dup2(inner, 1)\nos.close(inner)\nos.close(outer)\n"
        "from rig.cli import run_output\nfrom rig.cli.output import console\n"
        "from rig.experiment.run import RunResult\n"
        "from runs.records import RunFooter, Status\n"
        "result = RunResult(RunFooter(0, Status.INTERRUPTED, 'the terminal was closed'), None, None)\n"
        "run_output.last_screen(console(), result)\n"
        "sys.exit(run_output.exit_status(result))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "")
