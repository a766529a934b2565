"""softrig without its extras: archives are read and analysed, also on Windows; the rest says what it needs.

The wheel is installed with no extra, with `rig` and with `live`, and each is tried away from the checkout.
"""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from runs.archive.writer import finalise
from scripts.live_client import printed_link, request
from tests.support.light_venv import environment
from tests.support.synthetic_runs import write_journal

ROOT = Path(__file__).parents[2]
PATIENCE_S = 300.0
# What the extras bring; the servers come with nicegui.
EXTRA = ("cv2", "scipy", "numba", "piqp", "daqp", "rocrate", "nicegui", "fastapi", "starlette", "uvicorn")
UNIX = ("fcntl", "termios", "tty", "pwd", "grp", "resource")
ABSENT = (*EXTRA, *UNIX)
SHORT = "title: Short\nsteps:\n  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}\n  - hold: {duration_s: 1}\n"
READ = """
import sys
for name in {absent}: sys.modules[name] = None
import runs
run = runs.open({archive!r})
assert run.tip.measured_mm.shape[1] == 3
from runs.summary import summarise
assert summarise(run).frames_measured > 0
from runs.export import exporters
from pathlib import Path
for kind in ("csv", "mat", "mcap", "yaml"):
    exporters.export(Path({archive!r}), kind, Path({archive!r}).with_name("out." + kind))
print(Path(runs.__file__).parent)
"""


# Linux has what this takes away; macOS lacks the last one, Windows all.
WITHOUT_UNIX = f"""
import os, signal, sys
for name in {UNIX}: sys.modules[name] = None
del signal.SIGHUP, os.getuid, os.sched_getaffinity
"""


def commands(*calls: Sequence[str]) -> str:
    """A program that calls `rig` some times, and ends with the first failure."""
    return f"""
from rig.cli.app import main
for words in {calls}:
    try:
        main(words)
    except SystemExit as end:
        if end.code: raise
"""


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    journal = write_journal(tmp_path / "run.journal").path
    return finalise(journal)


def python(program: str, folder: Path, **env: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env=os.environ | env,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )


def test_an_archive_is_analysed_without_the_extras_and_without_unix(archive: Path, tmp_path: Path) -> None:
    done = python(READ.format(absent=ABSENT, archive=str(archive)), tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        ("['run', 'ramp-a', '--fast', '--yes', '--no-report']", "rig"),
        ("['run', 'ramp-a', '--yes', '--no-report']", "rig"),
        ("['live']", "live"),
    ],
)
def test_a_command_that_needs_an_extra_names_it(archive: Path, tmp_path: Path, command: str, extra: str) -> None:
    (tmp_path / "data").mkdir()
    archive.rename(tmp_path / "data" / archive.name)
    program = (
        f"import sys\nfor name in {EXTRA}: sys.modules[name] = None\nfrom rig.cli.app import main\nmain({command})\n"
    )
    done = python(program, tmp_path)
    assert done.returncode == 1, done.stderr
    assert done.stderr.strip().endswith(f"pip install 'softrig[{extra}]'"), done.stderr
    assert "Traceback" not in done.stderr


def test_runs_is_imported_without_the_compiler_and_without_locks(tmp_path: Path) -> None:
    """Where they are installed, too: reading an archive does not wait for them."""
    program = "import sys, runs\nprint([name for name in ('numba', 'fcntl', 'rig', 'model') if name in sys.modules])\n"
    assert python(program, tmp_path).stdout.strip() == "[]"


WITHOUT_EXTRAS = f"import sys\nfor name in {EXTRA}: sys.modules[name] = None\n"


def test_an_archive_is_shown_noted_reported_and_exported_without_vision_compiler_and_scipy(
    archive: Path, tmp_path: Path
) -> None:
    calls = [
        ["show", "run.h5"], ["show", "run.h5", "--json"], ["runs", "."], ["note", "run.h5", "a note"],
        *(["export", "run.h5", "--format", to] for to in ("csv", "mat", "mcap", "yaml")),
        ["report", "run.h5"], ["report", "run.h5", "--figures", "--out", "figures"],
    ]  # fmt: skip
    done = python(WITHOUT_EXTRAS + commands(*calls), tmp_path)
    assert done.returncode == 0, done.stderr
    assert {"run-tip.csv", "run.mat", "run.foxglove.mcap", "run-inputs", "run.html"} <= {
        path.name for path in tmp_path.iterdir()
    }
    assert "data:image/jpeg" in (tmp_path / "run.html").read_text()


@pytest.mark.slow
def test_an_archive_is_shown_exported_and_reported_without_what_only_unix_has(archive: Path, tmp_path: Path) -> None:
    done = python(WITHOUT_UNIX + commands(["show", "run.h5"], ["export", "run.h5"], ["report", "run.h5"]), tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run-tip.csv").exists()
    assert (tmp_path / "run.html").exists()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-index", "--no-build-isolation")
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, "-w", str(folder), str(ROOT)], check=True)
    (built,) = folder.glob("softrig-*.whl")
    return built


def installed(python: Path, *words: str, succeeds: bool = True) -> str:
    """Call `rig` of an installation in its folder, away from the checkout; returns what it prints."""
    command = [str(python), "-m", "rig", *words]
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        command, cwd=python.parents[2], env=env, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert (done.returncode == 0) is succeeds, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.realtime
def test_the_wheel_holds_the_program_and_its_data_only(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert not [name for name in names if name.split("/")[0] in ("tests", "docs", "benchmarks", "scripts")]
    data = ("rig/rigs/mock.yaml", "protocols/library/ramp-a.yaml", "rig/live/static/live.js", "runs/report/report.css")
    assert set(data) <= set(names)


@pytest.mark.realtime
def test_softrig_reads_and_analyses_an_archive(wheel: Path, archive: Path, tmp_path: Path) -> None:
    light = environment(tmp_path / "light", wheel, "")
    program = READ.format(absent=(), archive=str(archive))
    done = subprocess.run([str(light), "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()).is_relative_to(tmp_path / "light")
    assert "finished" in installed(light, "show", "run.h5")
    installed(light, "report", "run.h5")
    installed(light, "export", "run.h5")
    for words, extra in (
        (("run", "ramp-a", "--fast", "--yes"), "rig"),
        (("run", "ramp-a", "--yes"), "rig"),
        (("live",), "live"),
    ):
        assert f"pip install 'softrig[{extra}]'" in installed(light, *words, succeeds=False)


@pytest.mark.realtime
def test_softrig_rig_runs_an_experiment(wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    light = environment(tmp_path / "light", wheel, "rig")
    # The kernels of another place are compiled anew, for more than a minute.
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    (tmp_path / "brief.yaml").write_text(SHORT.replace("duration_s: 1", "duration_s: 0.2").replace("0.3", "0.1"))
    run = ("run", "brief.yaml", "--rig", "mock-no-camera", "--fast", "--yes", "--no-report", "--out", "data")
    assert "finished" in installed(light, *run)
    assert list((tmp_path / "data").glob("*.h5"))
    assert "softrig[live]" in installed(light, "live", succeeds=False)


@pytest.mark.realtime
def test_an_arm_is_identified_without_what_only_unix_has(tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(SHORT)
    run = python(commands(["run", "short.yaml", "--rig", "mock-ideal", "--fast", "--yes", "--no-report"]), tmp_path)
    assert run.returncode == 0, run.stderr
    fit = ["identify", "fit", "last", "--free", "a1_per_n", "--quasi-static", "--every", "3"]
    done = python(WITHOUT_UNIX + commands(fit), tmp_path)
    assert done.returncode == 0, done.stderr
    assert "a1_per_n" in done.stdout


@pytest.mark.realtime
def test_softrig_live_serves_the_page_of_a_run(wheel: Path, tmp_path: Path) -> None:
    light = environment(tmp_path / "light", wheel, "live")
    log = tmp_path / "log"
    (tmp_path / "short.yaml").write_text(SHORT)
    command = [str(light), "-u", "-m", "rig", "run", "short.yaml", "--rig", "mock-no-camera", "--yes", "--no-report"]
    with (
        log.open("w") as output,
        subprocess.Popen([*command, "--live", "--port", "0"], cwd=tmp_path, stdout=output, stderr=output) as run,
    ):
        try:
            link = printed_link(log.read_text, "live page")
            page = link.partition("?")[0]
            assert request(page)[0] == 401
            status, cookie = request(link)
            assert status == 303
            # The run compiles its kernels for longer than this takes.
            assert request(page, Cookie=cookie)[0] == 200
        finally:
            run.terminate()
    assert "Traceback" not in log.read_text()
