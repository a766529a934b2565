"""Throughput of two Dask workers beside two processes that share nothing; both read and identify the same archives.

Run: python -m benchmarks.scheduler data/*.h5 [--count 200] [--rounds 10] [--only read]

The archives are repeated to `--count` tasks, and each task is one archive. Both sides are started and warm before the
first measurement; they are measured in turn, `--rounds` times, each time with a share of the tasks. Printed are medians
of the ratio of the throughputs, by wall time, and of the ratio of the processor time that the tasks cost; that of the
workers contains scheduler and client. On a machine with other work the second is the surer one.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import runs
from calibration.identify.data import poses_of
from calibration.parallel_map import parallel_map
from model.arrays import Array
from rig.identify.estimation import from_poses
from rig.identify.initial_setup import rig_of

PROCESSES = 2
FREE = ("law", "rpe_per_bar", "base", "sensor_offsets")
_TICK_S = 1 / os.sysconf("SC_CLK_TCK")


def read(file: Path) -> Array:
    """The measured tips [m] of an archive."""
    return poses_of(runs.open(file)).tip_m


def identified(file: Path) -> Array:
    """The estimates from an archive."""
    run = runs.open(file)
    return np.array([one.used for one in from_poses(rig_of(run), [poses_of(run)], FREE, {}).estimates])


WORK = {"read": read, "identify": identified}


@dataclass(frozen=True)
class Cost:
    """Wall time and processor time [s] of some tasks."""

    wall_s: float
    cpu_s: float


def cpu_s(pids: Sequence[int]) -> float:
    """Processor time [s] of processes."""
    # The name of a program, in brackets, may contain spaces.
    fields = [Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in pids]
    return sum(int(one[11]) + int(one[12]) for one in fields) * _TICK_S


def measured(work: object, pids: Sequence[int]) -> Cost:
    """What a callable costs, in processes."""
    assert callable(work)
    before, began = cpu_s(pids), time.perf_counter()
    work()
    return Cost(time.perf_counter() - began, cpu_s(pids) - before)


@contextmanager
def started(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A Python process with pipes, terminated at the end."""
    with subprocess.Popen(
        [sys.executable, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def line_with(process: subprocess.Popen[str], pattern: str) -> str:
    """The first group of a pattern in the output of a process; waits for it."""
    assert process.stdout is not None
    for line in process.stdout:
        if found := re.search(pattern, line):
            return found[1]
    raise RuntimeError(f"{process.args} ended without a line with {pattern}")


class SeparateProcesses:
    """Two processes that read names of archives from their standard input, and work on them."""

    def __init__(self, stack: ExitStack, work: str) -> None:
        arguments = ("-m", "benchmarks.scheduler", "--serve", work)
        self._processes = [stack.enter_context(started(*arguments)) for _ in range(PROCESSES)]
        self.pids = [process.pid for process in self._processes]

    def do(self, files: Sequence[Path]) -> None:
        """Work on the files, every second one in each process."""
        for k, process in enumerate(self._processes):
            assert process.stdin is not None
            process.stdin.write("\t".join(map(str, files[k::PROCESSES])) + "\n")
            process.stdin.flush()
        for process in self._processes:
            line_with(process, "(done)")


class DaskWorkers:
    """A Dask scheduler and two workers of one thread, as `--scheduler` uses them."""

    def __init__(self, stack: ExitStack, work: str) -> None:
        scheduler = stack.enter_context(
            started("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        )
        self.address = line_with(scheduler, r"Scheduler at:\s+(tcp://\S+)")
        arguments = ("-m", "distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-dashboard")
        workers = [stack.enter_context(started(*arguments, "--no-nanny")) for _ in range(PROCESSES)]
        for worker in workers:
            line_with(worker, "(Registered to)")
        self.pids = [os.getpid(), scheduler.pid, *(worker.pid for worker in workers)]
        self._work = WORK[work]

    def do(self, files: Sequence[Path]) -> None:
        """Work on the files as a command with `--scheduler` does."""
        parallel_map(self._work, files, scheduler=self.address)


def serve(work: str) -> None:
    """Work on the archives that each line of the standard input names."""
    for line in sys.stdin:
        for name in line.rstrip("\n").split("\t"):
            WORK[work](Path(name))
        print("done", flush=True)


def main() -> None:
    """Measure both sides in turn and print the ratios."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("archives", type=Path, nargs="*")
    options.add_argument("--count", type=int, default=200, help="archives on each side, in all rounds")
    options.add_argument("--rounds", type=int, default=10)
    options.add_argument(
        "--only", choices=WORK, help="what to do with each archive; default: both, one after the other"
    )
    options.add_argument("--serve", choices=WORK, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.serve:
        serve(given.serve)
        return
    if not given.archives:
        options.error("name some archives")
    files = [file.resolve() for file in given.archives]
    share = [files[k % len(files)] for k in range(given.count // given.rounds)]
    for work in [given.only] if given.only else WORK:
        with ExitStack() as stack:
            sides = (SeparateProcesses(stack, work), DaskWorkers(stack, work))
            for side in sides:
                side.do(share[: 2 * PROCESSES])
            found = []
            for k in range(given.rounds):
                costs = {side: measured(lambda side=side: side.do(share), side.pids) for side in sides[:: (-1) ** k]}
                found.append([costs[side] for side in sides])
        walls = np.array([[one.wall_s for one in pair] for pair in found])
        cpus = np.array([[one.cpu_s for one in pair] for pair in found])
        per_minute = 60 * len(share) / np.median(walls, axis=0)
        for name, values in (("throughput", walls), ("processor time", cpus)):
            ratios = values[:, 0] / values[:, 1]
            low, middle, high = np.percentile(ratios, [25, 50, 75])
            print(f"{work}: {name}, {middle:.3f} ({low:.3f} .. {high:.3f})")
        print(
            f"{work}: {len(share)} archives in each of {given.rounds} rounds, {per_minute[0]:.0f} a minute by two "
            f"processes, {per_minute[1]:.0f} by two workers; {np.median(cpus[:, 0]) / len(share):.3f} and "
            f"{np.median(cpus[:, 1]) / len(share):.3f} s of processor time each",
            flush=True,
        )


if __name__ == "__main__":
    main()
