"""Kill -9 the process that records a run, again and again at random moments, and see what is left.

`python -m benchmarks.kills` kills virtual runs, each in a process of its own, and holds what was recovered against the
same run left alone: every row must be the same. With `--real-time` it kills the supervisor of `rig run` and prints how
much older than the kill the last recorded sample is.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import runs
from rig.config import loader
from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from runs.archive.digest import checked
from runs.records import Status
from runs.recovery import RecoveryStatus, recover
from runs.run import Run

PROTOCOL = """title: To be killed
steps:
  - ramp: {actuators: [1, 2, 3], to_bar: 0.3, duration_s: 2}
  - hold: {duration_s: %d}
"""
PATIENCE_S = 60.0


def run_fast(folder: Path, protocol: Path) -> Path:
    """One virtual run; the same arrays every time."""
    prepared = prepare(str(protocol), "mock", RunOptions(out=folder, fast=True, seed=1, report=False))
    archive = experiment.run(prepared, NullOperator()).archive
    assert archive is not None
    return archive


def await_journal(folder: Path) -> None:
    """Wait until a run has begun to record."""
    until = time.monotonic() + PATIENCE_S
    while not any(folder.glob("*.mcap")):
        if time.monotonic() > until:
            raise TimeoutError(f"no journal appeared in {folder}")
        time.sleep(0.001)


def recovered(folder: Path) -> Run:
    """The archive of what was killed; it must be whole, and marked as recovered unless the run had ended."""
    outcomes = [o for o in recover(folder) if o.status is not RecoveryStatus.REMOVED]
    (outcome,) = outcomes
    assert outcome.archive is not None, outcome.message
    assert "not readable" not in outcome.message or outcome.status is RecoveryStatus.RECOVERED, outcome.message
    checked(outcome.archive)
    return runs.open(outcome.archive)


def virtual(trials: int, seed: int, place: Path) -> None:
    """Kill virtual runs."""
    chance = random.Random(seed)
    protocol = place / "protocol.yaml"
    protocol.write_text(PROTOCOL % 3)
    run_fast(place / "first", protocol)  # what is compiled and imported at its first use is there by then
    began = time.monotonic()
    whole = runs.open(run_fast(place / "whole", protocol))
    # Half of a run passes between its first recorded row and its last; before and after, it starts and is finalised.
    takes_s = 0.5 * (time.monotonic() - began)
    cycles, torn, ended = [], 0, 0
    for trial in range(trials):
        folder = place / f"{trial}"
        folder.mkdir()
        child = os.fork()
        if child == 0:
            run_fast(folder, protocol)
            os._exit(0)
        await_journal(folder)
        time.sleep(chance.uniform(0, takes_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        run = recovered(folder)
        n, m = len(run.pressure.time_s), len(run.tip.time_s)
        np.testing.assert_array_equal(run.pressure.measured_bar, whole.pressure.measured_bar[:n])
        np.testing.assert_array_equal(run.tip.measured_mm, whole.tip.measured_mm[:m])
        ended += run.status is Status.FINISHED
        torn += any(e.source == "recovery" and not e.message.endswith("nothing") for e in run.events)
        cycles.append(n)
    print(
        f"{trials} virtual runs killed: {ended} had ended, {torn} with a torn last block, every row as in the whole run"
    )
    print(f"cycles recorded: {min(cycles)} to {max(cycles)} of {len(whole.pressure.time_s)}")


def real_time(trials: int, seed: int, place: Path) -> None:
    """Kill the supervisor of `rig run`."""
    chance = random.Random(seed)
    protocol = place / "protocol.yaml"
    protocol.write_text(PROTOCOL % 60)
    ages_s = []
    for trial in range(trials):
        folder = place / f"{trial}"
        folder.mkdir()
        rig = folder / "rig.yaml"
        rig.write_text(loader.text("mock").replace("device: mock0", f"device: kills-{os.getpid()}-{trial}"))
        command = [
            sys.executable,
            "-P",
            "-m",
            "rig",
            "run",
            str(protocol),
            "--rig",
            str(rig),
            "--out",
            str(folder / "out"),
        ]
        with subprocess.Popen([*command, "--yes", "--no-report"], stdout=subprocess.DEVNULL) as process:
            await_journal(folder / "out")
            time.sleep(0.3 + chance.uniform(0, 2))
            process.kill()
            killed_ns = time.monotonic_ns()
        run = recovered(folder / "out")
        last_ns = run.header.started_t_ns + round(float(run.pressure.time_s[-1]) * 1e9)
        ages_s.append((killed_ns - last_ns) / 1e9)
        assert run.status is Status.RECOVERED
    ages_ms = np.array(ages_s) * 1e3
    print(
        f"{trials} supervisors killed: the last recorded sample was {np.median(ages_ms):.0f} ms old in the median, "
        f"{ages_ms.max():.0f} ms at most"
    )


def main() -> None:
    """Run the trials."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--real-time", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        (real_time if options.real_time else virtual)(options.trials, options.seed, Path(place))


if __name__ == "__main__":
    main()
