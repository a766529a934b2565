"""The paper's six experiments, recorded or simulated in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rig.execution.plan import NullOperator, StartError
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.reproduce.comparison import ResultOrigin
from runs.archive.writer import ArchiveError
from runs.records import Status
from runs.run import Run

PROTOCOLS = ("extension-weights", "extension-pressure", "ramp-a", "ramp-b", "sine-1", "sine-2")


def recorded_or_simulated(
    folder: Path, protocols: tuple[str, ...] = PROTOCOLS, report: Callable[[str], None] = lambda _: None
) -> dict[str, Run]:
    """The newest finished archive of each protocol in a folder; missing ones are simulated on the mock rig.

    report: called with a line before each run.

    Raises:
        StartError: a simulated run did not finish.
    """
    found = _archives(folder)
    for name in protocols:
        if name not in found:
            report(f"simulating {name} on the mock rig")
            found[name] = _simulated(folder, name)
    return {name: found[name] for name in protocols}


def origin(*runs: Run) -> ResultOrigin:
    """Whether all of some runs were measured: a result of a simulated one is simulated."""
    return "simulated" if any(run.header.simulated for run in runs) else "measured"


def _archives(folder: Path) -> dict[str, Run]:
    found = {}
    for path in sorted(folder.glob("*.h5")):
        try:
            run = Run(path)
            header = run.header
            known = header.protocol_name in PROTOCOLS and not header.parent and run.status is Status.FINISHED
        except ArchiveError:
            continue
        if known and header.executor in ("real time", "virtual time"):  # the model alone measures nothing
            found[run.header.protocol_name] = run
    return found


def _simulated(folder: Path, name: str) -> Run:
    prepared = prepare(name, "mock-ideal", RunOptions(out=folder, fast=True, report=False))
    result = experiment.run(prepared, NullOperator())
    if result.archive is None or result.outcome.status is not Status.FINISHED:
        raise StartError(f"{name} could not be simulated: {result.outcome.message}")
    return Run(result.archive)
