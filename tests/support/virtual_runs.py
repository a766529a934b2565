"""Runs in virtual time, by the library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.execution.plan import NullOperator, OperatorInterface
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from runs.run import Run


def virtual_run(
    protocol: str | Path,
    rig: str | Path = "mock",
    *,
    folder: Path,
    seed: int = 1,
    report: bool = False,
    interface: OperatorInterface | None = None,
    **more: Any,
) -> Run:
    """Run a protocol with the archive in `folder`; `more` are options of the run."""
    prepared = prepare(str(protocol), str(rig), RunOptions(out=folder, fast=True, seed=seed, report=report, **more))
    result = experiment.run(prepared, interface or NullOperator())
    assert result.archive is not None, result.outcome
    return Run(result.archive)


def protocol_file(folder: Path, steps: str) -> Path:
    """A protocol of these steps."""
    path = folder / "protocol.yaml"
    path.write_text(f"title: For a test\nsteps:\n{steps}")
    return path
