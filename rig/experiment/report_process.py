"""Report process: imports its libraries during the run and writes the report at the end."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path

BeginReport = Callable[[Path], Callable[[], Path]]
"""Begins the report of an archive; returns a function that waits until it is written and returns its path."""


def prepared(fast: bool) -> AbstractContextManager[BeginReport]:
    """Return what begins the report of a run: in real time nothing is imported during the control loop."""
    return started() if fast else nullcontext(begin_here)


@contextmanager
def started() -> Iterator[BeginReport]:
    """Start the report process; yield a function that begins the report of one archive in it.

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

    def begin(archive: Path) -> Callable[[], Path]:
        if process is None:
            return partial(write_here, archive)
        assert process.stdin is not None
        with suppress(OSError), process.stdin as archives:
            archives.write(os.fsencode(archive))
        return partial(_finished, process, archive)

    try:
        yield begin
    finally:
        if process is not None:
            process.kill()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]
            process.wait()


def _finished(process: subprocess.Popen[bytes], archive: Path) -> Path:
    assert process.stdout is not None
    drawn = process.stdout.read()
    return Path(os.fsdecode(drawn)) if process.wait() == 0 else write_here(archive)


def write_here(archive: Path) -> Path:
    """Write the report in this process."""
    from runs.report.page import write

    return write([archive])


def begin_here(archive: Path) -> Callable[[], Path]:
    """The report is written in this process, by the function that waits for it."""
    return partial(write_here, archive)


def main() -> int:
    """Report process: import, wait for an archive, write its report; exit at end of input."""
    # The process ends with its one report: nothing is gained by scans for garbage.
    gc.disable()
    import runs.report.page  # noqa: F401
    from runs.report.drawing import load_fonts_and_layouts

    load_fonts_and_layouts()
    if archive := sys.stdin.buffer.read():
        sys.stdout.buffer.write(os.fsencode(write_here(Path(os.fsdecode(archive)))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
