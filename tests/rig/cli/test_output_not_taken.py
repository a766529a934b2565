"""Standard output that takes nothing: a pipe without a reader, a full disk."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


def outcome(arguments: tuple[str, ...], stdout: int, cwd: Path) -> tuple[int, str]:
    """Exit status and standard error of `rig` with these words."""
    command = [sys.executable, "-m", "rig", *arguments]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, stdout=stdout, stderr=subprocess.PIPE, text=True, cwd=cwd, check=False
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize("arguments", [("protocols",), ("init",), ("--version",)])
def test_a_pipe_without_a_reader_is_no_error_to_report(arguments: tuple[str, ...], tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        assert outcome(arguments, writer, tmp_path) == (1, "")
    finally:
        os.close(writer)


@pytest.mark.parametrize("arguments", [("protocols",), ("--version",), ("--help",), ("vent", "--help")])
def test_a_full_disk_under_the_output_is_one_message(arguments: tuple[str, ...], tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        assert outcome(arguments, full.fileno(), tmp_path) == (1, "No space left on device\n")
