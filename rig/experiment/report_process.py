"""The report at a run's end, drawn by a process of its own that loads its libraries while the run goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def waiting() -> Iterator[Callable[[Path], Path]]:
    """Have a process ready; what is given draws the report of one archive beside it and returns its path.

    What goes wrong in that process goes wrong once more in this one, and is raised from here.
    """
    process = None
    with suppress(OSError):
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "rig.experiment.report_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def draw(archive: Path) -> Path:
        if process is not None:
            drawn, _ = process.communicate(os.fsencode(archive))
            if process.returncode == 0:
                return Path(os.fsdecode(drawn))
        return here(archive)

    try:
        yield draw
    finally:
        if process is not None and process.returncode is None:
            process.kill()
            process.communicate()


def here(archive: Path) -> Path:
    """Draw the report in this process."""
    from runs.report.page import write

    return write([archive])


def main() -> int:
    """In that process: load, wait for an archive, draw; nothing where its end comes first."""
    import runs.report.page  # noqa: F401

    if archive := sys.stdin.buffer.read():
        sys.stdout.buffer.write(os.fsencode(here(Path(os.fsdecode(archive)))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
