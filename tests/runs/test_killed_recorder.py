"""The archive of a run whose recorder was killed holds every row that was written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_record_of_a_killed_run_equals_the_start_of_the_whole_run() -> None:
    command = [sys.executable, "-m", "benchmarks.kills", "--trials", "2"]
    env = os.environ | {"PYTHONPATH": str(HOUSE)}
    done = subprocess.run(command, cwd=HOUSE, env=env, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("2 virtual runs killed")
