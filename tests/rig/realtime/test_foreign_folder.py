"""A folder's own modules are never imported by the processes that a command starts, whatever they are called."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scripts.rig_process import BRIEF, write_rig

RIG = Path(sys.executable).with_name("rig")
NAMES = ("rig", "model", "runs", "protocols", "calibration", "numpy", "struct", "pickle", "signal", "multiprocessing")
HOSTILE = "import os\nos.open({marker!r}, os.O_CREAT | os.O_WRONLY)\nos._exit(77)\n"
POOL = """
import operator

from calibration.parallel_map import parallel_map

if __name__ == "__main__":
    print([int(result) for result in parallel_map(operator.neg, [1, 2, 3], workers=2)])
"""


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """The current folder of the command."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text(HOSTILE.format(marker=str(tmp_path / "imported")))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", [("--fast",), pytest.param(("--no-report",), marks=pytest.mark.realtime)], ids=["virtual time", "real time"]
)
def test_a_run_imports_nothing_from_the_current_folder(hostile: Path, how: tuple[str, ...]) -> None:
    (hostile / "brief.yaml").write_text(BRIEF)
    rig = write_rig(hostile, supervised=False)
    done = subprocess.run(
        [RIG, "run", "brief.yaml", "--rig", rig, "--yes", "--out", "out", *how],
        cwd=hostile,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert not (hostile.parent / "imported").exists()
    assert len(list((hostile / "out").glob("*.h5"))) == 1


def test_workers_of_an_identification_import_nothing_from_the_current_folder(hostile: Path) -> None:
    program = hostile.parent / "program.py"
    program.write_text(POOL)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONSAFEPATH"}
    done = subprocess.run(
        [sys.executable, program], cwd=hostile, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout == "[-1, -2, -3]\n", done.stderr
    assert not (hostile.parent / "imported").exists()
