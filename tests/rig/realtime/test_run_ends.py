"""How `rig run` ends after repeated signals, or with closed standard streams."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PROTOCOL = """title: Little
steps:
  - ramp: {actuators: [1], to_bar: 0.2, duration_s: DURATION}
"""


def command(folder: Path, duration_s: float) -> list[str]:
    protocol = folder / "little.yaml"
    protocol.write_text(PROTOCOL.replace("DURATION", str(duration_s)))
    out = ["--out", str(folder / "out")]
    return [sys.executable, "-m", "rig", "run", str(protocol), "--fast", "--yes", "--no-report", *out]


@pytest.mark.slow
@pytest.mark.parametrize("closed", ["<&-", ">&-", "<&- >&- 2>&-"])
def test_a_run_with_closed_standard_streams_finishes(tmp_path: Path, closed: str) -> None:
    done = subprocess.run(["/bin/sh", "-c", f'exec "$@" {closed}', "sh", *command(tmp_path, 0.2)], check=False)
    assert done.returncode == 0
    assert len(list((tmp_path / "out").glob("*.h5"))) == 1


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_run_that_is_signalled_repeatedly_still_reports_how_it_ended(tmp_path: Path, number: int) -> None:
    with subprocess.Popen(
        command(tmp_path, 600.0), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        while "armed" not in (line := process.stdout.readline()):
            assert line
        while process.poll() is None:
            process.send_signal(number)
            time.sleep(0.01)
        said = process.stdout.read()
    assert process.returncode == 130
    assert "interrupted: " in said
    assert "archive  " in said
