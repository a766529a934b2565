"""Pause and resume in the terminal: one key, in a terminal of its own; none where there is no terminal."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import runs
from scripts.rig_process import SHORT, write_rig

pytestmark = pytest.mark.realtime

PATIENCE_S = 150.0


def read_until(terminal: int, words: bytes) -> bytes:
    """What a terminal shows until some words have come."""
    seen = b""
    deadline = time.monotonic() + PATIENCE_S
    while words not in seen:
        assert time.monotonic() < deadline, seen[-2000:]
        if select.select([terminal], [], [], 0.1)[0]:
            try:
                seen += os.read(terminal, 65536)
            except OSError:  # the run has ended and its end of the terminal is closed
                raise AssertionError(f"ended without {words!r}: {seen[-3000:].decode(errors='replace')}") from None
    return seen


def test_p_pauses_and_resumes_and_leaves_the_terminal_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "protocol.yaml").write_text(SHORT)
    rig_file = write_rig(tmp_path)
    terminal, inside = pty.openpty()
    command = [sys.executable, "-m", "rig", "run", str(tmp_path / "protocol.yaml"), "--rig", str(rig_file)]
    # The run is the foreground of a terminal of its own, as it is under a shell.
    process = subprocess.Popen(
        [sys.executable, "-c", _LEAD, *command, "--out", str(tmp_path), "--yes", "--no-report"],
        stdin=inside,
        stdout=inside,
        stderr=inside,
        start_new_session=True,
        env={**os.environ, "TERM": "xterm"},
    )
    os.close(inside)
    try:
        read_until(terminal, b"p pauses")
        time.sleep(0.3)
        os.write(terminal, b"p")
        read_until(terminal, b"PAUSED")
        time.sleep(0.5)
        os.write(terminal, b"p")
        read_until(terminal, b"resumed by")
        os.write(terminal, b"\x03")
        read_until(terminal, b"archive")
        assert process.wait(PATIENCE_S) == 130
    finally:
        process.kill()
        process.wait()
        os.close(terminal)
    archive = runs.open(next(tmp_path.glob("*.h5")))
    told = [event.message for event in archive.events if event.source == "operator"]
    assert [("(terminal)" in line) for line in told[:2]] == [True, True]
    still_s = np.diff(archive.pressure.time_s)[np.diff(archive.pressure.protocol_s) == 0].sum()
    assert still_s > 0.4


_LEAD = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""
