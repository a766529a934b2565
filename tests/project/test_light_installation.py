"""softrig without its extras: archives are read and analysed, also without fcntl; the rest says what it needs."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from runs.archive.writer import finalise
from tests.support.synthetic_runs import write_journal

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120.0
# What the extras bring; the servers come with nicegui.
EXTRA = ("numba", "piqp", "nicegui", "fastapi", "starlette", "uvicorn")
ABSENT = (*EXTRA, "fcntl", "termios", "pwd", "grp")
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
for kind in ("csv", "mat"):
    exporters.export(Path({archive!r}), kind, Path({archive!r}).with_name("out." + kind))
print(Path(runs.__file__).parent)
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
    ("command", "extra"), [("['run', 'ramp-a', '--fast', '--yes', '--no-report']", "rig"), ("['live', 'last']", "live")]
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


@pytest.mark.realtime
def test_a_wheel_works_outside_the_checkout(archive: Path, tmp_path: Path) -> None:
    options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-index")
    wheel = [sys.executable, "-m", "pip", "wheel", *options, "--no-build-isolation", "-w", str(tmp_path), str(ROOT)]
    subprocess.run(wheel, check=True)
    (built,) = tmp_path.glob("softrig-*.whl")
    names = zipfile.ZipFile(built).namelist()
    assert not [name for name in names if name.split("/")[0] in ("tests", "docs", "benchmarks", "scripts")]
    site = tmp_path / "site"
    subprocess.run([sys.executable, "-m", "pip", "install", *options, "--target", str(site), str(built)], check=True)
    done = python(READ.format(absent=ABSENT, archive=str(archive)), tmp_path, PYTHONPATH=str(site))
    assert done.stdout.strip() == str(site / "runs"), done.stderr
    for command, says in (("['protocols']", "ramp-a"), ("['show', 'run.h5']", "finished"), ("['drivers']", "comedi")):
        shown = python(f"from rig.cli.app import main\nmain({command})", tmp_path, PYTHONPATH=str(site))
        assert says in shown.stdout, shown.stderr
    data = ("rig/rigs/mock.yaml", "protocols/library/ramp-a.yaml", "rig/live/static/live.js", "runs/report/report.css")
    assert set(data) <= set(names)
