"""Standard output that takes nothing: a pipe without a reader, a full disk."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
RIG = "import sys; from rig.__main__ import main; sys.argv[0] = 'rig'; main()"
SHELL_COMPLETION = [
    {"_RIG_COMPLETE": "complete_bash", "COMP_WORDS": "rig ", "COMP_CWORD": "1"},
    {"_RIG_COMPLETE": "source_bash"},
]


def outcome(arguments: tuple[str, ...], stdout: int, cwd: Path, **environment: str) -> tuple[int, str]:
    """Exit status and standard error of `rig` with these words."""
    command = [sys.executable, "-c", RIG, *arguments]
    env = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    options = {"stdin": subprocess.DEVNULL, "stdout": stdout, "stderr": subprocess.PIPE, "cwd": cwd, "env": env}
    done = subprocess.run(command, text=True, check=False, **options)
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


@pytest.mark.parametrize("request_of_the_shell", SHELL_COMPLETION)
def test_a_full_disk_under_the_completion_of_a_shell_is_one_message(
    request_of_the_shell: dict[str, str], tmp_path: Path
) -> None:
    with Path("/dev/full").open("w") as full:
        assert outcome((), full.fileno(), tmp_path, **request_of_the_shell) == (1, "No space left on device\n")
