"""Every reader of an archive, in a process of its own: `python archive_readers.py` is given archives line by line.

For each it prints one line of JSON: what each reader made of it. A process that crashes has met a file that HDF5 cannot
read safely.
"""

from __future__ import annotations

import contextlib
import io
import json
import resource
import sys
import traceback
import warnings
from pathlib import Path

import runs
from rig.cli import app as cli
from runs.archive.writer import ArchiveError, verify
from runs.catalogue import catalogue
from runs.summary import summarise
from tests.support.repeated_work import avoid_repeated_work

MOST_BYTES = 12 << 30
"""Address space; threads and compiled kernels take much of it."""
COMMANDS = (
    ("show",),
    ("show", "--json"),
    ("export", "--format", "csv"),
    ("export", "--format", "mat"),
    ("export", "--format", "mcap"),
    ("export", "--format", "yaml"),
    ("report",),
    ("replay", "--out", "replayed"),
    ("identify", "--free", "shear_ratio"),
    ("publish", "--creator", "Ada Lovelace", "--licence", "CC-BY-4.0", "--replace"),
)
CHEAP = (("show",), ("export", "--format", "csv"), ("export", "--format", "mat"), ("export", "--format", "mcap"))


def python(path: Path) -> str:
    """Read everything from Python."""
    try:
        run = runs.open(path)
        for name in ("header", "status", "message", "duration_s", "pressure", "tip", "adaptation", "timing"):
            getattr(run, name)
        for name in ("simulated", "backbone", "events", "frames"):
            getattr(run, name)
        for k in range(len(run.frames.index)):
            run.picture(k)
        for group in ("pressure", "tip", "adaptation", "timing", "simulator", "events", "segments"):
            with contextlib.suppress(ArchiveError):
                run.to_pandas(group)
        summarise(run)
        verify(path)
    except ArchiveError as fault:
        return f"refused: {fault}"
    return "read"


def command(arguments: list[str]) -> tuple[int, str]:
    """Run a command; return its exit status and output."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            cli.main(arguments)
        except SystemExit as end:
            return int(end.code or 0), said.getvalue()
    return 0, said.getvalue()


def troubles(path: Path, *, thorough: bool) -> list[str]:
    """Try every reader and return what went wrong."""
    found = []
    outcome = python(path)
    if "\n" in outcome or (outcome != "read" and path.name not in outcome):
        found.append(f"python: {outcome}")
    (entry,) = catalogue(path.parent)
    if outcome == "read" and entry.problem:
        found.append(f"catalogue: {entry.problem}")
    cases = [
        ["runs", str(path.parent)],
        *([name, str(path), *rest] for name, *rest in (COMMANDS if thorough else CHEAP)),
    ]
    for arguments in cases:
        status, said = command(arguments)
        fine = (0,) if arguments[0] == "runs" else (0, 2)
        if status not in fine or "Traceback" in said or "\x1b" in said or "\u202e" in said:
            found.append(f"{arguments[0]} {arguments[2:]} ended with {status}: {said[-2000:]}")
    return found


def main() -> None:
    """Read paths from standard input."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    warnings.simplefilter("error")
    avoid_repeated_work()
    for line in sys.stdin:
        path, thorough = json.loads(line)
        try:
            found = troubles(Path(path), thorough=thorough)
        except Exception:
            found = [traceback.format_exc()[-3000:]]
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
