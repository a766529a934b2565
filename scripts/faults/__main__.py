"""`python -m scripts.faults`: run the campaign, print what came of each fault, write the table."""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import random
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

from scripts.faults import realtime, table, virtual
from scripts.faults.catalogue import CATALOGUE, Fault
from scripts.faults.trial import EARLIEST_S, LATEST_S, Trial

EXECUTORS = ("real", "virtual")


@dataclass(frozen=True)
class Job:
    """One trial to be made; the same campaign has the same ones, whatever part of it is asked for."""

    fault: Fault
    executor: str
    at_s: float
    seed: int

    @property
    def key(self) -> tuple[str, str, float]:
        """What tells it from every other, and finds its trial in a log."""
        return self.fault.name, self.executor, self.at_s


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for; 0 when every trial came out as it must."""
    parser = argparse.ArgumentParser(prog="python -m scripts.faults", description=__doc__)
    parser.add_argument("--trials", type=int, default=10, help="random moments per fault and executor")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--executor", choices=(*EXECUTORS, "both"), default="both")
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--beside", type=int, default=os.cpu_count() or 1, help="runs in real time side by side")
    parser.add_argument("--write", type=Path, help="Markdown file whose table is replaced")
    parser.add_argument("--log", type=Path, help="file of trials to add to; what is in it already is not tried again")
    parser.add_argument("--list", action="store_true", help="name the faults and do nothing")
    options = parser.parse_args(arguments)
    faults = [fault for fault in CATALOGUE if options.only in fault.name]
    if options.list:
        print("\n".join(f"{fault.kind:14}{fault.name}" for fault in faults))
        return 0
    executors = EXECUTORS if options.executor == "both" else (options.executor,)
    trials = _logged(options.log)
    known = {(trial.fault, trial.executor, trial.at_s) for trial in trials}
    due = [job for job in jobs(faults, executors, options.trials, options.seed) if job.key not in known]
    for number, made in enumerate(_tried(due, options.beside), 1):
        trials.append(made)
        print(f"{number}/{len(due)} {line(made)}", flush=True)
        if options.log:
            with options.log.open("a") as log:
                log.write(json.dumps(asdict(made)) + "\n")
    if options.write:
        table.write(options.write, faults, trials)
    bad = [trial for trial in trials if trial.wrong]
    print(f"{len(trials)} trials of {len({t.fault for t in trials})} faults, {len(bad)} not as they must be")
    for trial in bad:
        print(f"  {line(trial)}")
    return 1 if bad else 0


def jobs(faults: Sequence[Fault], executors: Sequence[str], moments: int, seed: int) -> Iterator[Job]:
    """Every fault once, in any order, then every fault again: a campaign that is broken off has tried all alike."""
    for moment in range(moments):
        turn = [(fault, executor) for fault in faults for executor in executors if getattr(fault, executor)]
        random.Random(f"{seed} {moment}").shuffle(turn)
        for fault, executor in turn:
            chance = random.Random(f"{seed} {moment} {fault.name} {executor}")
            yield Job(fault, executor, chance.uniform(EARLIEST_S, LATEST_S), chance.randrange(2**31))


def _logged(log: Path | None) -> list[Trial]:
    if log is None or not log.exists():
        return []
    return [Trial(**json.loads(text)) for text in log.read_text().splitlines()]


def _tried(due: Sequence[Job], beside: int) -> Iterator[Trial]:
    """Make the trials, each as it comes: real time side by side, virtual time in what the machine has left."""
    spawn = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        pools = {
            "real": stack.enter_context(ProcessPoolExecutor(beside, spawn)),
            "virtual": stack.enter_context(ProcessPoolExecutor(1, spawn, os.nice, (10,))),
        }
        made: list[Future[Trial]] = [pools[job.executor].submit(_try, job) for job in due]
        try:
            for future in as_completed(made):
                yield future.result()
        finally:
            for future in made:
                future.cancel()


def _try(job: Job) -> Trial:
    with tempfile.TemporaryDirectory(prefix="softrig-faults-") as folder:
        trial = virtual.trial if job.executor == "virtual" else realtime.trial
        try:
            return trial(job.fault, Path(folder), job.at_s, job.seed)
        except Exception as error:
            wrong = f"{type(error).__name__}: {error}"
            return Trial(job.fault.name, job.executor, job.at_s, "no trial", "", math.nan, math.nan, wrong)


def line(trial: Trial) -> str:
    """One trial in one line."""
    head = f"{trial.executor:8}{trial.fault}, {trial.at_s:.2f} s"
    if trial.skipped:
        return f"{head}: not tried: {trial.skipped}"
    body = f"{trial.status}, safe after {trial.safe_s * 1e3:.0f} ms, {trial.lost_s * 1e3:.0f} ms lost: {trial.told}"
    return f"{head}: {body}{'  WRONG: ' + trial.wrong if trial.wrong else ''}"


if __name__ == "__main__":
    sys.exit(main())
