"""The reference firmware, compiled for this machine and driven over a pseudo-terminal."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FIRMWARE = Path(__file__).parents[1] / "docs" / "examples" / "firmware"
FLAGS = ("-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1")


class NoCompilerError(Exception):
    """There is no C++ compiler; the message says what to install."""


def compiled(folder: Path) -> Path:
    """The firmware as a program in a folder.

    Raises:
        NoCompilerError: there is no C++ compiler.
    """
    compiler = shutil.which("g++") or shutil.which("c++")
    if compiler is None:
        raise NoCompilerError("no C++ compiler: the reference firmware cannot be compiled (sudo apt-get install g++)")
    program = folder / "pressure_controller"
    subprocess.run([compiler, *FLAGS, str(FIRMWARE / "host.cpp"), "-o", str(program)], check=True)
    return program


class Controller:
    """A running controller; `device` is its port."""

    def __init__(self, program: Path, log: Path, silence_us: int) -> None:
        self.master, self.slave = os.openpty()
        self.device = os.ttyname(self.slave)
        self.log = log
        with log.open("w") as states:
            self.process = subprocess.Popen(
                [program, str(silence_us)], stdin=self.master, stdout=self.master, stderr=states
            )

    def states(self) -> list[tuple[int, int]]:
        """Changes of state: the new one, and the time since something was received [us]."""
        return [(int(words[1]), int(words[2])) for words in map(str.split, self.log.read_text().splitlines())]

    def unplug(self) -> None:
        """The port disappears."""
        self.process.kill()
        self.process.wait()
        for end in (self.master, self.slave):
            if end >= 0:
                os.close(end)
        self.master = self.slave = -1


@contextmanager
def controller(program: Path, folder: Path, silence_us: int = 50_000) -> Iterator[Controller]:
    """A running controller on a port of its own."""
    running = Controller(program, folder / "states", silence_us)
    try:
        yield running
    finally:
        running.unplug()
