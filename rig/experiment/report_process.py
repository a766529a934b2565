"""Report process: imports its libraries during the run and writes the report at the end."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def waiting() -> Iterator[Callable[[Path], Path]]:
    """Start the report process; yield a function that writes the report of one archive and returns its path.

    After a failure of that process this one writes the report, and raises its error.
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
    """Write the report in this process."""
    from runs.report.page import write

    return write([archive])


def main() -> int:
    """Report process: import, wait for an archive, write its report; exit at end of input."""
    import runs.report.page  # noqa: F401

    if archive := sys.stdin.buffer.read():
        sys.stdout.buffer.write(os.fsencode(here(Path(os.fsdecode(archive)))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
