"""Shell completion: protocols, rigs and runs, without the modules that take long to import."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
RIG = """
import sys
from rig.cli.app import main
try:
    main()
finally:
    heavy = {"numpy", "numba", "h5py", "scipy", "rich.console"} & set(sys.modules)
    assert not heavy, heavy
"""


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    for name in ("20261122-101500-sine-1", "20261122-101700-ramp-a"):
        (tmp_path / "data" / f"{name}.h5").touch()
    (tmp_path / "mine.yaml").touch()
    (tmp_path / "notes.txt").touch()
    return tmp_path


def completed(folder: Path, line: str) -> list[str]:
    """What the shell offers for the last word of a line."""
    words = line.split(" ")
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), "_RIG_COMPLETE": "complete_bash", "COMP_WORDS": line,
                    "COMP_CWORD": str(len(words) - 1)}  # fmt: skip
    code = f"import sys; sys.argv[0] = 'rig'{RIG}"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=surroundings, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("rig run sine-", ["sine-1", "sine-2"]),
        ("rig check mi", ["mine.yaml"]),
        (
            "rig check ramp-a --rig moc",
            [
                "mock",
                "mock-3",
                "mock-charuco",
                "mock-ideal",
                "mock-no-camera",
                "mock-stereo",
                "mock-tracker",
                "mock-two-sections",
            ],
        ),
        ("rig show la", ["last"]),
        ("rig show 20261122-1015", ["20261122-101500-sine-1"]),
        ("rig show data/20261122-1015", ["data/20261122-101500-sine-1.h5"]),
        ("rig identify 20261122-1017", ["20261122-101700-ramp-a"]),
        ("rig identify comp", ["compare"]),
        ("rig identify --split", ["--split-s"]),
        ("rig identify compare la", ["last"]),
        ("rig run nothing", []),
    ],
)
def test_the_shell_offers_what_there_is(here: Path, line: str, offered: list[str]) -> None:
    assert completed(here, line) == offered
